"""The processes of one fit: who started them, how they find each other, and what happens where one is lost.

They are started by ``torchrun``, by ``srun``, by any program that sets the same variables, or by the fit itself, for several
devices; on each computer by hand with MASTER_ADDR, MASTER_PORT and NODE_RANK.
"""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import threading
import time
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import timedelta
from typing import Any

import lightning as L
import torch
from lightning.fabric.plugins.environments import SLURMEnvironment, TorchElasticEnvironment
from lightning.pytorch.strategies import DDPStrategy
from lightning.pytorch.strategies.launchers import _SubprocessScriptLauncher
from lightning.pytorch.utilities.rank_zero import rank_zero_only
from torch import distributed

from uplift.config.progress import is_quiet, quiet
from uplift.config.settings import TrainerSettings
from uplift.errors import UserError

__all__ = ["Layout", "as_one", "from_rank_0", "is_lost", "join", "plugins", "processes", "start", "trainer_flags"]

_TORCHRUN = ("RANK", "WORLD_SIZE", "LOCAL_RANK", "MASTER_ADDR", "MASTER_PORT")
_SRUN = ("SLURM_NTASKS", "SLURM_PROCID", "SLURM_LOCALID")
_JOIN_S = 300.0
"""Most that processes wait for the last to start: none has read any data yet."""
_LOOK_S = 0.1


@dataclass(frozen=True)
class Layout:
    """The place of this process among those of the fit."""

    rank: int
    ranks: int
    local_rank: int
    local_ranks: int
    """Processes on this computer."""
    host: str
    port: int
    """Where rank 0 is found."""
    by: str
    """What started the processes."""

    def __post_init__(self) -> None:
        inside = 0 <= self.local_rank < self.local_ranks <= self.ranks and self.local_rank <= self.rank < self.ranks
        if not inside or self.ranks % self.local_ranks:
            raise UserError(
                f"{self.by} says that this is process {self.rank} of {self.ranks}, and {self.local_rank} of "
                f"{self.local_ranks} on this computer: expected numbers from 0 below those, and as many on each computer."
            )

    @property
    def nodes(self) -> int:
        """How many computers take part."""
        return self.ranks // self.local_ranks


@dataclass
class _Group:
    """What joined processes have in common."""

    layout: Layout
    store: distributed.Store
    children: list[subprocess.Popen]


_GROUP: _Group | None = None


# Who started the processes.


def join(settings: TrainerSettings) -> None:
    """Join the other processes of the fit, where the environment says that there are any.

    Raises UserError: variables that contradict each other or the settings, or processes that do not come.
    """
    if _GROUP is None and (layout := _found(os.environ)) is not None:
        _check_settings(layout, settings)
        _meet(layout, settings, [])


def start(trainer: L.Trainer, settings: TrainerSettings) -> None:
    """Start this command once more for each further device of ``trainer``, and join those processes."""
    count, nodes = processes(trainer), trainer.num_nodes
    if _GROUP is not None or count * nodes == 1:
        return
    host, port, node = "127.0.0.1", _free_port(), 0
    if nodes > 1:
        host, port, node = os.environ["MASTER_ADDR"], *_numbers(os.environ, "MASTER_PORT", "NODE_RANK")
    layouts = [
        Layout(node * count + place, nodes * count, place, count, host, port, "trainer.devices")
        for place in range(count)
    ]
    main = sys.modules["__main__"].__spec__
    words = [os.path.abspath(sys.argv[0])] if main is None else ["-m", main.name]
    command = [sys.executable, *words, *sys.argv[1:]]
    children = [subprocess.Popen(command, env={**os.environ, **_variables(one)}) for one in layouts[1:]]
    try:
        _meet(layouts[0], settings, children)
    except BaseException:
        _stop(children)
        raise


def processes(trainer: L.Trainer) -> int:
    """Return how many processes Lightning would start for ``trainer`` on this computer."""
    strategy = trainer.strategy
    return trainer.num_devices if isinstance(strategy.launcher, _SubprocessScriptLauncher) else 1


def _found(environ: Mapping[str, str]) -> Layout | None:
    """Return the layout that ``torchrun``, or else ``srun``, gave this process; None for a process of its own."""
    if any(name in environ for name in _TORCHRUN[:3]) and environ.get("WORLD_SIZE") != "1":
        missing = [name for name in _TORCHRUN if name not in environ]
        if missing:
            raise UserError(
                f"the environment has {', '.join(name for name in _TORCHRUN if name in environ)}, as torchrun sets, but not "
                f"{', '.join(missing)}: set them all, or none."
            )
        rank, ranks, local = _numbers(environ, "RANK", "WORLD_SIZE", "LOCAL_RANK")
        (port,) = _numbers(environ, "MASTER_PORT")
        (here,) = _numbers({"LOCAL_WORLD_SIZE": str(ranks), **environ}, "LOCAL_WORLD_SIZE")
        return Layout(rank, ranks, local, here, environ["MASTER_ADDR"], port, "torchrun")
    return _of_srun(environ)


def _of_srun(environ: Mapping[str, str]) -> Layout | None:
    if environ.get("SLURM_NTASKS", "1") == "1" or environ.get("SLURM_JOB_NAME") in ("bash", "interactive"):
        return None
    missing = [name for name in _SRUN if name not in environ]
    if missing:
        raise UserError(
            f"SLURM_NTASKS={environ['SLURM_NTASKS']}, but {', '.join(missing)} are not set: start the command with srun, "
            "or take out --ntasks for a fit in one process."
        )
    ranks, rank, local = _numbers(environ, *_SRUN)
    (nodes,) = _numbers({"SLURM_NNODES": "1", **environ}, "SLURM_NNODES")
    (here,) = _numbers({"SLURM_NTASKS_PER_NODE": str(ranks // max(1, nodes)), **environ}, "SLURM_NTASKS_PER_NODE")
    names = ("SLURM_STEP_NODELIST", "SLURM_JOB_NODELIST", "SLURM_NODELIST")
    listed = next((environ[name] for name in names if name in environ), "127.0.0.1")
    host = environ.get("MASTER_ADDR") or SLURMEnvironment.resolve_root_node_address(listed)
    job, step = _numbers({"SLURM_JOB_ID": "0", "SLURM_STEP_ID": "0", **environ}, "SLURM_JOB_ID", "SLURM_STEP_ID")
    (port,) = _numbers({"MASTER_PORT": str(15_000 + (job + step) % 10_000), **environ}, "MASTER_PORT")
    return Layout(rank, ranks, local, here, host, port, "srun")


def _numbers(environ: Mapping[str, str], *names: str) -> list[int]:
    """Return the variables of these names as numbers; raises UserError for one that is none, or is not set."""
    for name in names:
        if not environ.get(name, "").isdigit():
            raise UserError(f"{name}={environ.get(name, '(not set)')}: expected a whole number in this variable.")
    return [int(environ[name]) for name in names]


def _check_settings(layout: Layout, settings: TrainerSettings) -> None:
    """Raise UserError where devices or computers are set and others were started."""
    devices, nodes = settings.devices, settings.flags.get("num_nodes", layout.nodes)
    if devices not in ("auto", "-1", str(layout.local_ranks)):
        raise UserError(
            f"trainer.devices={devices}, but {layout.by} started {layout.local_ranks} processes on this computer, one for "
            "each device: leave trainer.devices out, or give both the same number."
        )
    if nodes != layout.nodes:
        raise UserError(
            f"trainer.num_nodes={nodes}, but {layout.by} started processes on {layout.nodes}: leave trainer.num_nodes out."
        )


def _free_port() -> int:
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return one.getsockname()[1]


def _variables(layout: Layout) -> dict[str, str]:
    """Return the variables that torchrun would set."""
    values = (layout.rank, layout.ranks, layout.local_rank, layout.host, layout.port)
    more = {"LOCAL_WORLD_SIZE": layout.local_ranks, "GROUP_RANK": layout.rank // layout.local_ranks}
    return {name: str(value) for name, value in {**dict(zip(_TORCHRUN, values, strict=True)), **more}.items()}


# How they find each other.


def _meet(layout: Layout, settings: TrainerSettings, children: list[subprocess.Popen]) -> None:
    """Wait until all processes are there, and connect them."""
    global _GROUP
    wait = min(_JOIN_S, settings.wait)
    store = _store(layout, wait)
    _wait_for_all(store, layout, wait, children)
    gpu = settings.accelerator in ("gpu", "cuda") or (settings.accelerator == "auto" and torch.cuda.is_available())
    if gpu:
        torch.cuda.set_device(layout.local_rank)
    backend = "cpu:gloo,cuda:nccl" if gpu else "gloo"
    distributed.init_process_group(
        backend,
        store=distributed.PrefixStore("group", store),
        rank=layout.rank,
        world_size=layout.ranks,
        timeout=timedelta(seconds=settings.wait),
    )
    os.environ.update(_variables(layout))
    rank_zero_only.rank = layout.rank
    _GROUP = _Group(layout, store, children)


def _store(layout: Layout, wait: float) -> distributed.Store:
    """Return what all processes read and write: rank 0 keeps it, or torchrun."""
    kept = os.environ.get("TORCHELASTIC_USE_AGENT_STORE") == "True" and layout.by == "torchrun"
    keeps = layout.rank == 0 and not kept
    where = f"MASTER_ADDR={layout.host}, MASTER_PORT={layout.port}"
    try:
        _try_port(layout, wait, keeps)
        store = _opened(layout, wait, keeps)
    except (OSError, RuntimeError) as error:
        if keeps:
            raise UserError(f"{where}: another program uses this port, or it cannot be opened: set another.") from error
        raise UserError(
            f"process {layout.rank} of {layout.ranks} found no process 0 at {where} in {wait:.0f} s. Does it run there, and "
            "can this computer reach it?"
        ) from error
    return distributed.PrefixStore(f"uplift{os.environ.get('TORCHELASTIC_RESTART_COUNT', '')}", store)


def _opened(layout: Layout, wait: float, keeps: bool) -> distributed.Store:
    """Return the store; raises OSError where another program answers, for whose reply the library would wait for ever."""
    found: list[distributed.Store | RuntimeError] = []

    def open_it() -> None:
        try:
            one = distributed.TCPStore(
                layout.host, layout.port, None, keeps, timedelta(seconds=wait), wait_for_workers=False
            )
            one.add("answers", 1)
            found.append(one)
        except RuntimeError as error:
            found.append(error)

    thread = threading.Thread(target=open_it, daemon=True)
    thread.start()
    thread.join(wait)
    if not found:
        raise TimeoutError
    if isinstance(found[0], RuntimeError):
        raise found[0]
    return found[0]


def _try_port(layout: Layout, wait: float, keeps: bool) -> None:
    """Raise OSError where the port is taken, or nothing answers there in time: libraries write more than a line about it."""
    if keeps:
        with socket.socket() as one:
            one.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            one.bind(("", layout.port))
        return
    until = time.monotonic() + wait
    while True:
        try:
            socket.create_connection((layout.host, layout.port), timeout=max(0.1, until - time.monotonic())).close()
            return
        except OSError:
            if time.monotonic() > until:
                raise
            time.sleep(_LOOK_S)


def _wait_for_all(store: distributed.Store, layout: Layout, wait: float, children: list[subprocess.Popen]) -> None:
    if store.add(f"here{layout.rank}", 1) > 1:
        raise UserError(
            f"two processes say that they are number {layout.rank} of {layout.ranks} (RANK or SLURM_PROCID)."
        )
    until = time.monotonic() + wait
    while True:
        missing = [rank for rank in range(layout.ranks) if not store.check([f"here{rank}"])]
        if not missing:
            return
        ended = any(child.poll() is not None for child in children)
        if ended or time.monotonic() > until:
            why = "one ended (see its message)" if ended else f"waited {wait:.0f} s"
            named = ", ".join(map(str, missing[:8]))
            raise UserError(
                f"{layout.ranks - len(missing)} of {layout.ranks} processes started, {why}: there is no process {named}. "
                "Start all with one torchrun or srun."
            )
        time.sleep(_LOOK_S)


# What they do together.


def trainer_flags() -> dict[str, Any]:
    """Return the flags of Lightning's Trainer that make it one of the joined processes; none of a process of its own."""
    if _GROUP is None:
        return {}
    layout = _GROUP.layout
    # Buffers are the same on all ranks, and some hold a row for every frame.
    strategy = DDPStrategy(broadcast_buffers=False, gradient_as_bucket_view=True)
    return {"devices": layout.local_ranks, "num_nodes": layout.nodes, "strategy": strategy}


def plugins() -> list[Any]:
    """Return what tells a Trainer its rank."""
    return [] if _GROUP is None else [TorchElasticEnvironment()]


def from_rank_0(text: str) -> str:
    """Return rank 0's ``text`` on all ranks, which call it together."""
    if _GROUP is None:
        return text
    given = [text]
    distributed.broadcast_object_list(given, 0)
    return given[0]


@contextmanager
def as_one(resume: str = "the fit") -> Iterator[None]:
    """Let rank 0 speak for all: others say nothing, an error that several have is said once, and a lost process is named."""
    try:
        with quiet(is_quiet() or rank_zero_only.rank != 0), warnings.catch_warnings():
            if rank_zero_only.rank:
                warnings.simplefilter("ignore")
            yield
    except BaseException as error:
        if _GROUP is None:
            raise
        if is_lost(error):
            error = UserError(
                "another process of this fit ended or no longer answers: see its message. What was saved before is complete."
            )
        if _GROUP.children and not _is_interrupt(error):
            _stop(_GROUP.children)
        if not _says_first(error):
            raise SystemExit(130 if _is_interrupt(error) else 2) from error
        raise error


def is_lost(error: BaseException) -> bool:
    """Return whether an error is that of a connection to another process."""
    known = ("gloo", "Connection closed by peer", "Connection reset by peer", "Broken pipe", "Timed out waiting")
    kind = isinstance(error, distributed.DistError) or (
        isinstance(error, RuntimeError) and any(word in str(error) for word in known)
    )
    return _GROUP is not None and kind


def _is_interrupt(error: BaseException) -> bool:
    return isinstance(error, KeyboardInterrupt) or type(error).__name__ == "Interrupted"


def _says_first(error: BaseException) -> bool:
    """Return whether no other process has said the same; where they cannot be asked, what is no echo is said."""
    assert _GROUP is not None
    if _is_interrupt(error):
        return _GROUP.layout.rank == 0
    try:
        return _GROUP.store.add(f"said {type(error).__name__} {error}", 1) == 1
    except RuntimeError:
        return True


def _stop(children: list[subprocess.Popen]) -> None:
    """End the processes that this one started; SIGTERM alone would wait for a step that never ends."""
    for child in children:
        child.send_signal(signal.SIGKILL)
    for child in children:
        child.wait()
