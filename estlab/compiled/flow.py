"""Loops, conditions, addresses and calls in LLVM's language."""

from collections.abc import Mapping, Sequence


def loop(
    name: str, first: str, last: str, body: Sequence[str], carried: Mapping[str, tuple[str, str]] | None = None
) -> list[str]:
    """The body for %name from first to last. carried: values by name, of a type and from a first one on, whose next
    ones the body makes as %<name>_next.
    """
    return [
        f"br label %{name}_in",
        f"{name}_in:",
        f"br label %{name}_head",
        f"{name}_head:",
        f"%{name} = phi i64 [{first}, %{name}_in], [%{name}_next, %{name}_tail]",
        *(
            f"%{value} = phi {kind} [{start}, %{name}_in], [%{value}_next, %{name}_tail]"
            for value, (kind, start) in (carried or {}).items()
        ),
        f"%{name}_more = icmp slt i64 %{name}, {last}",
        f"br i1 %{name}_more, label %{name}_body, label %{name}_out",
        f"{name}_body:",
        *body,
        f"br label %{name}_tail",
        f"{name}_tail:",
        f"%{name}_next = add i64 %{name}, 1",
        f"br label %{name}_head",
        f"{name}_out:",
    ]


def when(name: str, condition: str, body: Sequence[str]) -> list[str]:
    """The body, executed if the condition, an i1, is true."""
    return [f"br i1 {condition}, label %{name}_yes, label %{name}_end", f"{name}_yes:", *body,
            f"br label %{name}_end", f"{name}_end:"]  # fmt: skip


def row(found: str, array: str, row: str, columns: str = "1", column: str = "0", kind: str = "double") -> list[str]:
    """The address of an entry of an array with so many columns."""
    return [
        f"%{found}_w = mul i64 {row}, {columns}",
        f"%{found}_x = add i64 %{found}_w, {column}",
        f"%{found} = getelementptr {kind}, ptr %{array}, i64 %{found}_x",
    ]


def filled(call: str, given: Mapping[str, str]) -> str:
    """A call with its parameters replaced."""
    head, _, rest = call.partition("(")
    parts = [part.rsplit(" ", 1) for part in rest.rstrip(")").split(", ")] if rest != ")" else []
    return f"{head}({', '.join(f'{kind} {given.get(name, name)}' for kind, name in parts)})"
