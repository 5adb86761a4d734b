"use strict";

// The number that a cell is sorted by, or its text; nothing for an empty one.
function keyOf(row, column) {
  const cell = row.cells[column];
  if (cell.dataset.number !== undefined) return Number(cell.dataset.number);
  const text = cell.textContent.trim();
  return text === "" ? null : text;
}

// Numbers before words, and what is empty last whichever way it goes.
function compare(a, b, sign) {
  if (a === null || b === null) return (a === null) - (b === null);
  if (typeof a !== typeof b) return typeof a === "number" ? -1 : 1;
  if (typeof a === "number") return sign * (a < b ? -1 : a > b ? 1 : 0);
  return sign * a.localeCompare(b, "en", { numeric: true });
}

function sort(table, head, column) {
  const up = head.getAttribute("aria-sort") !== "ascending";
  for (const other of head.parentNode.cells) other.removeAttribute("aria-sort");
  head.setAttribute("aria-sort", up ? "ascending" : "descending");
  const body = table.tBodies[0];
  const rows = Array.from(body.rows, (row) => [keyOf(row, column), row]);
  rows.sort((a, b) => compare(a[0], b[0], up ? 1 : -1));
  body.append(...rows.map((pair) => pair[1]));
}

function makeSortable(table) {
  Array.from(table.tHead.rows[0].cells).forEach((head, column) => {
    const button = document.createElement("button");
    button.type = "button";
    button.append(...head.childNodes);
    button.addEventListener("click", () => sort(table, head, column));
    head.append(button);
  });
}

// A field above the table that leaves the rows with every word typed.
function makeFiltered(box, number) {
  const rows = Array.from(box.querySelectorAll("tbody tr"));
  const texts = rows.map((row) => Array.from(row.cells, (cell) => cell.textContent).join(" ").toLowerCase());
  const line = document.createElement("p");
  const label = document.createElement("label");
  const field = document.createElement("input");
  const count = document.createElement("span");
  line.className = "filter";
  field.type = "search";
  field.id = "filter-" + number;
  label.htmlFor = field.id;
  label.textContent = "Show rows with";
  count.setAttribute("role", "status");
  field.addEventListener("input", () => {
    const words = field.value.toLowerCase().split(/\s+/).filter(Boolean);
    let shown = 0;
    rows.forEach((row, i) => {
      row.hidden = !words.every((word) => texts[i].includes(word));
      shown += !row.hidden;
    });
    count.textContent = words.length ? shown + " of " + rows.length + " rows" : "";
  });
  line.append(label, field, count);
  box.before(line);
}

function makePlotsLarge() {
  const figures = document.querySelectorAll("figure");
  if (!figures.length) return;
  const dialog = document.createElement("dialog");
  const close = document.createElement("button");
  const image = document.createElement("img");
  close.type = "button";
  close.textContent = "Close";
  close.addEventListener("click", () => dialog.close());
  image.addEventListener("click", () => dialog.close());
  dialog.append(close, image);
  document.body.append(dialog);
  for (const figure of figures) {
    const small = figure.querySelector("img");
    const button = document.createElement("button");
    button.type = "button";
    button.className = "enlarge";
    button.setAttribute("aria-label", "Enlarge: " + small.alt);
    small.before(button);
    button.append(small);
    button.addEventListener("click", () => {
      image.src = small.src;
      image.alt = small.alt;
      dialog.setAttribute("aria-label", small.alt);
      dialog.showModal();
    });
  }
}

document.querySelectorAll(".box table").forEach(makeSortable);
document.querySelectorAll("[data-filtered]").forEach(makeFiltered);
makePlotsLarge();
window.addEventListener("beforeprint", () => document.querySelectorAll("details").forEach((part) => (part.open = true)));
