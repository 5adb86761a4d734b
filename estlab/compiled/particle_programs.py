"""The programs of a particle filter: move, weigh, sum and select particles."""

from estlab.compiled import numpy_streams, particle_routines
from estlab.compiled.flow import loop, row, when
from estlab.compiled.model_graphs import MotionModel, SensorModel
from estlab.compiled.particle_choice import choose, resample
from estlab.compiled.particle_loops import ParticleColumn, each_run, of_run, once, over, program, zeros
from estlab.compiled.particle_routines import Entries
from estlab.maths.space import Space

# The arguments of each program, in this order, as 64 bits each: addresses, and numbers (in capitals). A name with
# _NEXT is the distance from one run's numbers to the next, 0 if runs share them; with _STRIDE, from one component to
# the next.
COMMON = ("RUNS", "COUNT", "row", "flags", "aside", "sums", "present")
STREAMS = ("state", "layers")
DRAWING = ("RUNS", "COUNT", "row", *STREAMS, "out", "NORMAL")
CHOOSING = ("RUNS", "COUNT", "weight", "u", "U_NEXT", "U_STRIDE", "strata", "edge", "position", "chosen")
RESAMPLING = ("weight", "log", "u", "U_NEXT", "U_STRIDE", "U_DRAWN", "strata")  # for a step that resamples
MOVING = (*COMMON, *STREAMS, "DRAWN", "z", "Z_NEXT", "before", "after", "CLOUD_STRIDE", "LAPSE", "control",
          "CONTROL_NEXT", "factor", "FACTOR_NEXT", "nth_few", *RESAMPLING, "edge", "position", "chosen", "even",
          "gathered")  # fmt: skip
NORMALISING = (*COMMON, "log", "linear", "size", "vanished", "pair")
NORMALISED = ("linear", "size", "vanished", "mean", "cov", "noise", "whitened", "log_scale")  # if weights are needed
WEIGHING = (*COMMON, "pair", "log", "NORMALISED", *NORMALISED, "point", "CLOUD_STRIDE", "log_before", "weight",
            "reading", "whitening", "WHITENING_NEXT", "landmark", "LANDMARK_NEXT", "expected",
            "EXPECTED_STRIDE")  # fmt: skip
SUMMING = (*COMMON, "vector", "CLOUD_STRIDE", "weight", "mean", "cov")

_LESS_THAN_ALL = "0xFFF0000000000000"


def moving(motion: MotionModel, factor: Entries, lanes: int) -> str:
    """The program that draws the noise of particles and moves them."""
    n, q = motion.space.size, motion.noises
    columns = {
        "z": ParticleColumn("%run_z", q, "%COUNT"),
        "before": ParticleColumn("%run_source", n, "%source_stride"),
        "after": ParticleColumn("%run_after", n, "%CLOUD_STRIDE"),
    }
    body = [
        *of_run("z", "%Z_NEXT"),
        *of_run("before", "%COUNT"),
        *of_run("after", "%COUNT"),
        *of_run("control", "%CONTROL_NEXT"),
        *of_run("factor", "%FACTOR_NEXT"),
        *of_run("weight", "%COUNT"),
        *of_run("log", "%COUNT"),
        *row("run_state", "state", "%number", "4"),
        *row("few_at", "nth_few", "%nth", kind="i64"),
        "%few = load i64, ptr %few_at, align 8",
        "%resampled = icmp sge i64 %few, 0",
        *when("resampling", "%resampled", resample(n)),
        "%run_source = select i1 %resampled, ptr %gathered, ptr %run_before",
        "%source_stride = select i1 %resampled, i64 %COUNT, i64 %CLOUD_STRIDE",
        "%dt = bitcast i64 %LAPSE to double",
        "%drawn = icmp ne i64 %DRAWN, 0",
        *when("drawing", "%drawn", [
            f"%normals = mul i64 %COUNT, {q}",
            "call void @normals(ptr %run_state, ptr %run_z, i64 %normals, ptr %layers)",
        ]),
        *over("m", particle_routines.move(motion, factor), columns, ("before", "z"), ("after",), lanes),
    ]  # fmt: skip
    return program(MOVING, each_run(body), lanes, numpy_streams.text(lanes))


def weighing(sensor: SensorModel, whitening: Entries, lanes: int) -> str:
    """The program that compares particles with a reading, and computes weights and the innovation."""
    n, m, space = sensor.state.size, sensor.space.size, sensor.space
    columns = {
        "point": ParticleColumn("%run_point", n, "%CLOUD_STRIDE"),
        "log_before": ParticleColumn("%run_log_before", 1, "0"),
        "weight": ParticleColumn("%run_weight", 1, "0", fill="0.0"),
        "log": ParticleColumn("%run_log", 1, "0"),
        "expected": ParticleColumn("%expected", m, "%EXPECTED_STRIDE", padded=True),
        "vector": ParticleColumn("%expected", m, "%EXPECTED_STRIDE", padded=True),
    }
    body = [
        *of_run("point", "%COUNT"),
        *of_run("log_before", "%COUNT"),
        *of_run("weight", "%COUNT"),
        *of_run("log", "%COUNT"),
        *of_run("reading", str(m)),
        *of_run("whitening", "%WHITENING_NEXT"),
        *of_run("landmark", "%LANDMARK_NEXT"),
        *of_run("mean", str(m)),
        *of_run("cov", str(m * m)),
        *of_run("whitened", str(m)),
        *of_run("log_scale", str(m)),
        *zeros("a", m + len(space.angles)),
        *over("b", particle_routines.look(sensor, whitening), columns, ("point", "log_before", "weight"),
              ("log",), lanes),
        "%normalised = icmp ne i64 %NORMALISED, 0",
        *when("normalising", "%normalised", [
            *once("c", particle_routines.mean(space), lanes),
            *zeros("d", m * (m + 1) // 2),
            *over("e", particle_routines.spread(space), columns, ("weight",), (), lanes),
            *once("f", particle_routines.covariance(space), lanes),
            *once("o", particle_routines.innovation(space), lanes),
            *_normalise(lanes),
        ]),
    ]  # fmt: skip
    return program(WEIGHING, each_run(body), lanes)


def normalising(lanes: int) -> str:
    """The program that turns logarithms into weights."""
    return program(NORMALISING, each_run([*of_run("log", "%COUNT"), *_normalise(lanes)]), lanes)


def _normalise(lanes: int) -> list[str]:
    columns = {"log": ParticleColumn("%run_log", 1, "0"), "linear": ParticleColumn("%run_linear", 1, "0")}
    both = ("log", "linear")
    return [
        *of_run("linear", "%COUNT"),
        *of_run("size", "1"),
        *of_run("vanished", "1"),
        *zeros("g", 1, _LESS_THAN_ALL),
        *over("h", particle_routines.peak(), columns, ("log",), (), lanes),
        *once("i", particle_routines.top(), lanes),
        *zeros("j", 2),
        *over("k", particle_routines.exponential(), columns, ("log",), both, lanes),
        *once("l", particle_routines.normaliser(), lanes),
        *over("n", particle_routines.share(), columns, both, both, lanes),
    ]


def summing(space: Space, lanes: int) -> str:
    """The program of the moments of clouds."""
    n = space.size
    columns = {
        "vector": ParticleColumn("%run_vector", n, "%CLOUD_STRIDE"),
        "weight": ParticleColumn("%run_weight", 1, "0", fill="0.0"),
    }
    body = [
        *of_run("vector", "%COUNT"),
        *of_run("weight", "%COUNT"),
        *of_run("mean", str(n)),
        *of_run("cov", str(n * n)),
        *zeros("a", n + len(space.angles)),
        *over("b", particle_routines.mean_sums(space), columns, ("vector", "weight"), (), lanes),
        *once("c", particle_routines.mean(space), lanes),
        *zeros("d", n * (n + 1) // 2),
        *over("e", particle_routines.spread(space), columns, ("vector", "weight"), (), lanes),
        *once("f", particle_routines.covariance(space), lanes),
    ]
    return program(SUMMING, each_run(body), lanes)


def choosing(lanes: int) -> str:
    """The program that selects particles by their weights, at given uniform numbers."""
    body = [
        *of_run("weight", "%COUNT"),
        *of_run("u", "%U_NEXT"),
        *of_run("chosen", "%COUNT"),
        *choose(),
    ]
    return program(CHOOSING, loop("nth", "0", "%RUNS", body), lanes)


def drawing(lanes: int) -> str:
    """The program that draws COUNT uniform or normal numbers from each run's stream."""
    body = [
        *row("row_at", "row", "%nth", kind="i64"),
        "%number = load i64, ptr %row_at, align 8",
        *row("run_state", "state", "%number", "4"),
        *of_run("out", "%COUNT"),
        "%normal = icmp ne i64 %NORMAL, 0",
        "%draw = select i1 %normal, ptr @normals, ptr @uniforms",
        "call void %draw(ptr %run_state, ptr %run_out, i64 %COUNT, ptr %layers)",
    ]
    return program(DRAWING, loop("nth", "0", "%RUNS", body), lanes, numpy_streams.text(lanes))
