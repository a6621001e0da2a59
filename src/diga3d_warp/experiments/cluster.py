"""Ray: workers on this machine or on those of a cluster. Imported only where it is used."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from types import ModuleType
from typing import Any

from diga3d_warp.errors import InputError
from diga3d_warp.experiments.job import LOG, JobFolder
from diga3d_warp.experiments.run import ATTEMPTS, TICK, Ended
from diga3d_warp.experiments.work import Work, attempt
from diga3d_warp.process import tune_process

INSTALL = "pip install 'diga3d-warp[cluster]'"

REACH = 10.0
"""Seconds in which a cluster's head must accept a connection. Ray itself would try for a minute or more."""

ANSWER = 40.0
"""Seconds in which it must tell its state."""

STORE_BYTES = 80 * 2**20
"""Ray's object store on this machine: jobs exchange files, never objects, and Ray takes no less."""


@dataclass(frozen=True)
class RayCrew:
    """Workers of Ray.

    Attributes:
        address: Of a cluster's head, HOST:PORT, ray://HOST:PORT or "auto"; None starts Ray on this machine.
        workers: Jobs at a time on this machine; a cluster runs as many as its resources allow.
        threads: Cores that a job asks for, and threads that it computes with.
        gpus: GPUs that a job asks for; a part of one lets jobs share it.
    """

    address: str | None = None
    workers: int = 1
    threads: int = 1
    gpus: float = 0.0

    def check(self) -> None:
        """Look for Ray and for the cluster, before anything is written.

        Raises:
            InputError: Ray is not installed, the address has no port, or no cluster answers there.
        """
        require_ray()
        if self.address is None:
            return
        _check_reachable(self.address)
        if self.address != "auto" and not self.address.startswith("ray://"):
            _check_answers(self.address)

    def __call__(self, folders: Sequence[JobFolder], work: Work, tick: Callable[[], None]) -> Iterator[Ended]:
        """Work on jobs; see `run.Crew`.

        Raises:
            InputError: Ray is not installed, the cluster cannot be reached, or none of its machines has what
                a job asks for.
        """
        if not folders:
            return
        ray = self._connect()
        try:
            self._check_resources(ray)
            task = ray.remote(
                num_cpus=self.threads, num_gpus=self.gpus, max_calls=1, max_retries=ATTEMPTS - 1
            )(_worker)
            pending = {
                task.remote(str(folder.path.resolve()), work, self.threads): folder for folder in folders
            }
            while pending:
                tick()
                done, _ = ray.wait(list(pending), num_returns=1, timeout=TICK)
                for reference in done:
                    folder, reason = pending.pop(reference), ""
                    try:
                        ray.get(reference)
                    except ray.exceptions.RayTaskError as error:
                        reason = str(error.cause or error)
                    except ray.exceptions.RayError as error:
                        ending = type(error).__name__
                        reason = f"its process ended {ATTEMPTS} times (Ray's {ending}): see its {LOG}"
                    yield Ended(folder, reason)
        finally:
            ray.shutdown()

    def _connect(self) -> ModuleType:
        ray = require_ray()
        # Of its own, Ray would try a job that takes too much memory for ever.
        os.environ.setdefault("RAY_task_oom_retries", str(ATTEMPTS - 1))
        options: dict[str, Any] = {"log_to_driver": False, "logging_level": "ERROR"}
        if self.address is None:
            os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
            os.environ.setdefault("RAY_worker_niceness", "0")  # of its own 15: all else would come first
            # The cores that `workers` jobs ask for: Ray starts as many at a time.
            options |= {"num_cpus": self.workers * self.threads, "object_store_memory": STORE_BYTES}
            options |= {"include_dashboard": False, "address": "local"}
        else:
            options["address"] = self.address
        try:
            ray.init(**options)
        except Exception as error:  # ConnectionError, RuntimeError, ValueError, by the kind of address
            where = "on this machine" if self.address is None else f"at {self.address}"
            reason = str(error).strip().splitlines() or [type(error).__name__]
            remedy = "use --no-ray"
            if self.address is not None:
                remedy = "check `ray status` there; a cluster with tokens needs RAY_AUTH_MODE=token"
            raise InputError(f"Ray cannot be used {where} ({reason[0]}): {remedy}") from error
        return ray

    def _check_resources(self, ray: ModuleType) -> None:
        """Refuse jobs that would wait for ever."""
        machines = [node["Resources"] for node in ray.nodes() if node["Alive"]]
        fits = [m for m in machines if m.get("CPU", 0) >= self.threads and m.get("GPU", 0) >= self.gpus]
        if not fits:
            most = {kind: max((m.get(kind, 0) for m in machines), default=0) for kind in ("CPU", "GPU")}
            raise InputError(
                f"a job asks for {self.threads} cores and {self.gpus:g} GPUs, but no machine of the cluster "
                f"has more than {most['CPU']:g} cores and {most['GPU']:g} GPUs: lower --cores or --gpus"
            )


def require_ray() -> ModuleType:
    """Ray.

    Raises:
        InputError: it is not installed, or not whole.
    """
    if find_spec("ray") is None:
        raise InputError(f"Ray is not installed: {INSTALL}, or leave --address and --ray out")
    try:
        import ray
    except ImportError as error:
        raise InputError(f"Ray cannot be loaded ({error}): {INSTALL} again, or use --no-ray") from error
    return ray


def _check_reachable(address: str) -> None:
    """Try to connect to a cluster's head.

    Raises:
        InputError: nothing answers there, or the address has no port.
    """
    if address == "auto":
        return
    host, colon, port = address.removeprefix("ray://").rpartition(":")
    if not (host and colon and port.isdecimal() and int(port) < 65536):
        raise InputError(f"--address {address} is not HOST:PORT, ray://HOST:PORT or auto")
    try:
        with socket.create_connection((host.strip("[]"), int(port)), timeout=REACH):
            pass
    except OSError as error:
        raise InputError(
            f"no cluster answers at {address} ({error.strerror or error}): start it with `ray start --head`, "
            "or leave --address out to run on this machine"
        ) from error


def _check_answers(address: str) -> None:
    """Ask a cluster for its state.

    Raises:
        InputError: what answers at the address is no cluster, or one that refuses us.
    """
    words = [sys.executable, "-m", "ray.scripts.scripts", "status", "--address", address]
    try:
        answered = subprocess.run(words, capture_output=True, timeout=ANSWER).returncode == 0
    except subprocess.TimeoutExpired:
        answered = False
    if not answered:
        raise InputError(
            f"what answers at {address} does not say that it is a Ray cluster: check `ray status --address "
            f"{address}`; one with tokens needs RAY_AUTH_MODE=token"
        )


def _worker(path: str, work: Work, threads: int) -> None:
    """What Ray runs, in a process of its own."""
    tune_process()
    attempt(path, work, threads)
