"""Peers in the same run: FElupe, torch-fem and feax do the job of the paper's beam.

One mesh (525 nodes, quadratic tets), one law that all can state (the paper's tensor in
the Green strain), one tolerance (forces out of balance 1e-8 of the forces), float64 on
the processor. Mesh, set-up and compilation are in no time. Each peer has the solver and
the number of threads with which it is quickest here, tried out first. The tip must move
to the same place in all, to 1e-6. Three tasks:

- static: pose 1 with p_target, from rest;
- gradient: half the squared error of the tip in pose 1, in units of the noise, and its
  gradient in the six parameters, at the start of Fig. 3 and from rest. By one adjoint
  solve in torch-fem and feax; FElupe has no adjoint: six forward differences, each from
  the equilibrium itself;
- calibration: four poses, from the start of Fig. 3. Ours is `multi_start` to its own
  end. No peer has a calibration: SciPy's `least_squares` with the Jacobian, adjoint or
  by differences, that is quicker, equilibria from the last ones where the peer takes a
  guess, stopped as soon as every parameter is within 1e-4 of p_target, which nobody
  with real data could do. It takes about 60 evaluations; the other methods of SciPy
  take 40 to 60, or do not arrive. A run that has not arrived within 300 s counts as
  300 s, and its ratio is a lower bound.

In favour of the peers: that stop; the fields of a tet and their derivatives come from
our compiled code. In ours: the mesh is small, where the calls of a Python library weigh
most; the poses of a calibration are solved side by side on all cores, those of a peer
one after the other; feax is made for GPUs, and its direct solvers other than SuperLU
need scikit-sparse, which PyPI has only as source that wants SuiteSparse; a call of a
peer takes 0.2 ms more, since each runs in a process of its own, in turns with ours. Not
here: jax-fem, which imports petsc4py, and PyPI has that only as source that wants
PETSc.
"""

import statistics
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from importlib.metadata import version
from typing import NamedTuple

import numpy as np

from benchmarks._paper import STD, recovered
from benchmarks._peer import AbstractPeer, peer_gradient
from benchmarks._peer_calibration import Arrival, calibrate_by, quicker_jacobian
from benchmarks._peer_job import (
    Job,
    our_calibration,
    our_gradient,
    our_static,
    peer_job,
)
from benchmarks._peer_process import PeerProcess
from benchmarks._problem import Better, Figure, Goal, Options, Outcome, Table
from benchmarks._timing import interleave, median_ms, ratio
from softcal_jax._typing import HostArray

STATIC_REPEATS = 9
GRADIENT_REPEATS = 5
CALIBRATION_REPEATS = 3
"""Timed calls of each task."""

LIMIT_S = 300.0
"""Wall time after which the calibration of a peer is given up, or not repeated [s]."""

POSE = 0
"""Pose of the first two tasks."""

TASKS = ("static", "gradient", "calibration")


class Library(NamedTuple):
    """Where a peer is, and how it is installed.

    Attributes:
        module: Module that `PeerProcess` opens.
        packages: Packages whose versions are told, the peer first.
        extra: Extra of this project that brings them.
    """

    module: str
    packages: tuple[str, ...]
    extra: str


LIBRARIES = {
    "felupe": Library("_peer_felupe", ("felupe", "pypardiso"), "benchmarks"),
    "torch_fem": Library("_peer_torch_fem", ("torch-fem", "torch"), "peers"),
    "feax": Library("_peer_feax", ("feax",), "peers"),
}


class Opened(NamedTuple):
    """A peer that is installed, and how it solves the job."""

    process: PeerProcess
    label: str


def run(options: Options) -> Outcome:
    """The three tasks by all libraries that are installed."""
    job = peer_job()
    with opened(LIBRARIES) as (peers, absent):
        for name, why in absent.items():
            options.say(f"{name}: {why}")
        return _compare(job, peers, absent, options)


def _compare(
    job: Job, peers: Mapping[str, Opened], absent: Mapping[str, str], options: Options
) -> Outcome:
    figures = our_end(job)
    for name, peer in peers.items():
        options.say(f"agreement of {name}")
        answers = (peer.process.ask(tips), peer.process.ask(by_parameter))
        figures |= _prefixed(name, agreement(job, name, *answers))
    options.say("static and gradient")
    seconds = {
        "static": interleave(_calls(job, peers, our_pose, static), STATIC_REPEATS),
        "gradient": interleave(
            _calls(job, peers, our_slope, by_parameter), GRADIENT_REPEATS
        ),
    }
    arrivals, adjoint = {}, {}
    for name, peer in peers.items():
        options.say(f"calibration by {name}")
        adjoint[name] = peer.process.ask(quicker_jacobian)
        arrivals[name] = _calibrations(peer.process, by_adjoint=adjoint[name])
    ours = interleave({"ours": lambda: our_calibration(job)}, CALIBRATION_REPEATS)
    theirs = {name: [a.seconds for a in runs] for name, runs in arrivals.items()}
    seconds["calibration"] = ours | theirs
    figures |= times(seconds)
    for name, peer in peers.items():
        said = {
            "version": _versions(LIBRARIES[name]),
            "solver": peer.label,
            "jacobian": "adjoint" if adjoint[name] else "differences",
            "arrived": sum(arrival.reached for arrival in arrivals[name]),
            "evaluations": arrivals[name][0].evaluations,
        }
        figures |= _prefixed(name, said)
    better: dict[str, Better] = {
        figure: "either"
        for figure in figures
        if figure.endswith(("_ms", "_s")) and not figure.startswith("ours")
    }
    goals = {
        f"{name}_{task}": Goal("at least", 1.0) for name in peers for task in TASKS
    }
    samples = {
        f"{name}_{task}_s": values
        for task, of_task in seconds.items()
        for name, values in of_task.items()
    }
    table = _table(figures, arrivals, absent)
    return Outcome(figures, samples, goals, [table], better)


@contextmanager
def opened(
    libraries: Mapping[str, Library], process: Callable[[], PeerProcess] = PeerProcess
) -> Iterator[tuple[dict[str, Opened], dict[str, str]]]:
    """Each installed peer in a process, and what to do about the others.

    Args:
        libraries: The peers by name.
        process: What starts a process.

    Yields:
        Peers, and a sentence for each that is not installed.
    """
    peers, absent = {}, {}
    with ExitStack() as stack:
        for name, library in libraries.items():
            started = stack.enter_context(process())
            try:
                peers[name] = Opened(started, started.open(library.module))
            except ModuleNotFoundError as error:
                if error.name is None or error.name.startswith("benchmarks"):
                    raise
                absent[name] = (
                    f"{error.name} is not installed: "
                    f"pip install softcal-jax[{library.extra}]"
                )
        yield peers, absent


def tips(peer: AbstractPeer) -> HostArray:
    """Displacement of the marker in all poses at p_target, by a peer [m]."""
    fields = peer.job.fields(peer.job.target)
    moved = [
        peer.solve(i, fields)[pose.marker] for i, pose in enumerate(peer.job.poses)
    ]
    return np.stack(moved)


def static(peer: AbstractPeer) -> None:
    """The first task, by a peer."""
    peer.solve(POSE, peer.job.fields(peer.job.target))


def our_pose(job: Job) -> None:
    """The same by us."""
    our_static(job, POSE, job.target)


def by_parameter(peer: AbstractPeer) -> HostArray:
    """The second task, by a peer."""
    return peer_gradient(peer, POSE, peer.job.start, STD).by_parameter


def our_slope(job: Job) -> HostArray:
    """The same by us."""
    return our_gradient(job, POSE, job.start).by_parameter


def agreement(
    job: Job, name: str, tips: HostArray, by_parameter: HostArray
) -> dict[str, Figure]:
    """Relative differences of a peer's tips, and of its gradient, from ours.

    Args:
        job: The job.
        name: Name of the peer.
        tips: What the peer finds for all poses [m].
        by_parameter: Its gradient.

    Raises:
        RuntimeError: If they exceed 1e-6 and 1e-3, and the times would compare nothing.
    """
    moved = []
    for i, (pose, theirs) in enumerate(zip(job.poses, tips, strict=True)):
        ours = np.asarray(our_static(job, i, job.target).displacement)[pose.marker]
        moved.append(_difference(name, "moves the tip by", ours, theirs, 1e-6))
    slope = _difference(name, "has the gradient", our_slope(job), by_parameter, 1e-3)
    return {"tip_difference": max(moved), "gradient_difference": slope}


def _difference(
    name: str, what: str, ours: HostArray, theirs: HostArray, limit: float
) -> float:
    difference = float(np.linalg.norm(ours - theirs) / np.linalg.norm(ours))
    if not difference <= limit:
        raise RuntimeError(
            f"{name} {what} {theirs} where ours is {ours}, relative difference "
            f"{difference:.1e}: the two do not solve the same problem."
        )
    return difference


def our_end(job: Job) -> dict[str, Figure]:
    """Whether our calibration finds p_target.

    Args:
        job: The job.
    """
    end = our_calibration(job)
    errors = job.errors(np.asarray(end.z[0]))
    return {
        "ours_largest_error": float(np.max(errors)),
        "ours_recovered": int(recovered(errors)),
        "ours_steps": int(end.steps[0]),
    }


def _prefixed(name: str, figures: Mapping[str, Figure]) -> dict[str, Figure]:
    return {f"{name}_{figure}": value for figure, value in figures.items()}


def _calls(job: Job, peers: Mapping[str, Opened], ours, theirs):
    """A task of all libraries, to be timed."""
    of_peers = {
        name: lambda process=peer.process: process.ask(theirs)
        for name, peer in peers.items()
    }
    return {"ours": lambda: ours(job), **of_peers}


def _calibrations(process: PeerProcess, *, by_adjoint: bool) -> list[Arrival]:
    """Timed runs of a peer, one at least."""
    runs: list[Arrival] = []
    while len(runs) < CALIBRATION_REPEATS and sum(r.seconds for r in runs) < LIMIT_S:
        end = process.ask(calibrate_by, by_adjoint=by_adjoint, limit_s=LIMIT_S)
        runs.append(end)
        if not end.reached:
            break
    return runs


def times(seconds: Mapping[str, Mapping[str, Sequence[float]]]) -> dict[str, Figure]:
    """Medians of all libraries, and those of the peers over ours.

    Args:
        seconds: Task to library to times, "ours" among them [s].
    """
    figures: dict[str, Figure] = {}
    for task, of_task in seconds.items():
        for name, values in of_task.items():
            if task == "calibration":
                figures[f"{name}_{task}_s"] = statistics.median(values)
            else:
                figures[f"{name}_{task}_ms"] = median_ms(values)
            if name != "ours":
                figures[f"{name}_{task}"] = ratio(values, of_task["ours"])
    return figures


def _versions(library: Library) -> str:
    return ", ".join(f"{name} {version(name)}" for name in library.packages)


def _table(
    figures: Mapping[str, Figure],
    arrivals: Mapping[str, Sequence[Arrival]],
    absent: Mapping[str, str],
) -> Table:
    """A row per library."""
    shown = lambda name: f"{figures[name]:.3g}"
    first = ["ours", "", shown("ours_static_ms"), shown("ours_gradient_ms")]
    rows = [[*first, f"{shown('ours_calibration_s')} s"]]
    for name, runs in arrivals.items():
        cells = [f"{figures[f'{name}_version']}; {figures[f'{name}_solver']}"]
        cells += [
            f"{shown(f'{name}_{task}_ms')} ({shown(f'{name}_{task}')} times ours)"
            for task in ("static", "gradient")
        ]
        by_ours = f"{shown(f'{name}_calibration')} times ours"
        arrived = all(run.reached for run in runs)
        end = by_ours if arrived else f"did not arrive, at least {by_ours}"
        how = f"{figures[f'{name}_jacobian']}, {runs[0].evaluations} evaluations"
        cells.append(f"{shown(f'{name}_calibration_s')} s ({end}; {how})")
        rows.append([name, *cells])
    rows += [[name, why, "", "", ""] for name, why in absent.items()]
    columns = ["library", "solver", "static ms", "gradient ms", "calibration"]
    return Table("The beam of Sec. V in the Green strain, medians", columns, rows)
