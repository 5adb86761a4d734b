"""Selects a run's particles by their weights, in LLVM's language."""

from estlab.compiled.flow import loop, row

_BEYOND_ALL = (1 << 63) - 1  # whose bits no number exceeds, not even NaN


def choose() -> list[str]:
    """Select the run's particles at the positions (strata[0] j + u[j]) / strata[1] of the cumulative weight.

    u: uniform numbers, one (with no stride) or one per particle. Edges are weights added in order.

    Positions ascend, so each step passes a position or a particle: without a branch, and with the data for the next
    step loaded in advance. Nonnegative numbers are ordered like their bits.
    """
    edge = [
        *row("weight_at", "run_weight", "%add"),
        "%weight_here = load double, ptr %weight_at, align 8",
        "%sum_next = fadd double %sum, %weight_here",
        *row("edge_at", "edge", "%add"),
        "store double %sum_next, ptr %edge_at, align 8",
    ]
    position = [
        *row("u_at", "run_u", "%of", "%U_STRIDE"),
        "%u_here = load double, ptr %u_at, align 8",
        "%stratum = sitofp i64 %of to double",
        "%below = fmul double %stratum, %per",
        "%above = fadd double %below, %u_here",
        "%share = fdiv double %above, %strata_count",
        "%there = fmul double %share, %end",
        *row("there_at", "position", "%of"),
        "store double %there, ptr %there_at, align 8",
    ]
    return [
        *loop("add", "0", "%COUNT", edge, {"sum": ("double", "0.0")}),
        *row("end_at", "edge", "%COUNT", "1", "-1"),
        "%end = load double, ptr %end_at, align 8",
        # No position lies beyond the last particle, whatever rounding says.
        f"store i64 {_BEYOND_ALL}, ptr %end_at, align 8",
        "%per = load double, ptr %strata, align 8",
        *row("strata_at", "strata", "1"),
        "%strata_count = load double, ptr %strata_at, align 8",
        *loop("of", "0", "%COUNT", position),
        "%limit_first = load i64, ptr %edge, align 8",
        "%place_first = load i64, ptr %position, align 8",
        "br label %pass_in",
        "pass_in:",
        "br label %pass",
        "pass:",
        "%j = phi i64 [0, %pass_in], [%j_next, %passing]",
        "%p = phi i64 [0, %pass_in], [%p_next, %passing]",
        "%limit = phi i64 [%limit_first, %pass_in], [%limit_next, %passing]",
        "%place = phi i64 [%place_first, %pass_in], [%place_next, %passing]",
        "%pass_more = icmp slt i64 %j, %COUNT",
        "br i1 %pass_more, label %passing, label %passed",
        "passing:",
        "%j_on = add i64 %j, 1",
        "%p_on = add i64 %p, 1",
        *row("place_at", "position", "%j_on"),
        "%place_on = load i64, ptr %place_at, align 8",
        *row("limit_at", "edge", "%p_on"),
        "%limit_on = load i64, ptr %limit_at, align 8",
        *row("chosen_at", "run_chosen", "%j", kind="i64"),
        "store i64 %p, ptr %chosen_at, align 8",
        "%within = icmp slt i64 %place, %limit",
        "%j_next = select i1 %within, i64 %j_on, i64 %j",
        "%p_next = select i1 %within, i64 %p, i64 %p_on",
        "%place_next = select i1 %within, i64 %place_on, i64 %place",
        "%limit_next = select i1 %within, i64 %limit, i64 %limit_on",
        "br label %pass",
        "passed:",
    ]


def resample(n: int) -> list[str]:
    """The run's particles selected by their weights, merged; weights made equal."""
    gather = [
        *row("from_at", "run_chosen", "%from", kind="i64"),
        "%parent = load i64, ptr %from_at, align 8",
    ]
    for i in range(n):
        gather += [
            *row(f"parent{i}_at", "run_before", str(i), "%CLOUD_STRIDE", "%parent"),
            f"%parent{i} = load double, ptr %parent{i}_at, align 8",
            *row(f"child{i}_at", "gathered", str(i), "%COUNT", "%from"),
            f"store double %parent{i}, ptr %child{i}_at, align 8",
        ]
    even = []
    for k, name in enumerate(("log", "weight")):
        even += [*row(f"{name}_even", f"run_{name}", "%from"), f"store double %even{k}, ptr %{name}_even, align 8"]
    return [
        *row("run_u", "u", "%few", "%U_NEXT"),
        "call void @uniforms(ptr %run_state, ptr %run_u, i64 %U_DRAWN, ptr %layers)",
        "%run_chosen = getelementptr i64, ptr %chosen, i64 0",
        *choose(),
        "%even0 = load double, ptr %even, align 8",
        *row("even1_at", "even", "1"),
        "%even1 = load double, ptr %even1_at, align 8",
        *loop("from", "0", "%COUNT", [*gather, *even]),
    ]
