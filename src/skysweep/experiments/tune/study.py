"""The study of a tuning. Only this module imports Optuna.

A study lives in a database, so several processes and machines may work on it at once. It holds all that a
resumed or joining process needs: the problem, and each trial's values, missions and end. Databases keep no
digests, so the study has its own, and refuses a trial that was changed.
"""

from __future__ import annotations

import hashlib
import json
import os
import socket
import sqlite3
import time
import warnings
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

from skysweep.errors import MissingExtraError, UserError
from skysweep.experiments.tune.race import Outcome, Outcomes, RaceRules
from skysweep.experiments.tune.space import Parameter

try:
    import fcntl
except ImportError:  # only POSIX has it
    fcntl = None  # type: ignore[assignment]

_STALE_S = 120.0  # a running trial without a sign of life for longer has lost its process
_CLAIM_S = 20.0  # a running trial that stays unclaimed for longer was never begun
_RANDOM_TRIALS = 12  # before the sampler learns from the results
_TOLD = ("values", "missions", "dropped", "same_as")  # attributes of a trial that ended
_SEALED = (*_TOLD, "violations")
_SEAL = "sha256"  # attribute with the digest of these, or, while a trial waits, of its values


@dataclass(frozen=True, slots=True)
class Trial:
    """One set of values and its results. ``missions`` are ordered by seed, then by scenario."""

    number: int
    values: dict[str, float]
    missions: list[Outcome]
    dropped: str | None  # why it was not worth all seeds
    same_as: int | None  # an earlier trial with the same values, whose missions it takes

    def flown(self, scenarios: int) -> Outcomes:
        return Outcomes.of(self.missions, scenarios)


class TuningStudy:
    """A study in a database, opened by one process.

    ``storage`` is an SQLAlchemy URL, such as ``sqlite:///study.db``; ``problem`` says what is tuned, as plain
    data; ``seed`` is the sampler's. Raises MissingExtraError without Optuna, and UserError when the database
    cannot be used, is damaged, or holds a study of another problem under this name.
    """

    def __init__(
        self,
        storage: str,
        name: str,
        problem: dict[str, Any],
        space: Sequence[Parameter],
        rules: RaceRules,
        seed: int,
    ) -> None:
        self._optuna = _optuna()
        self._state = self._optuna.trial.TrialState
        self._space, self._rules, self._seed = tuple(space), rules, seed
        self._storage, self._file = storage, storage.partition("sqlite:///")[2]
        self._locks = bool(self._file) and fcntl is not None
        directions = ["minimize"] * (2 if rules.min_recall is not None else 3)
        try:
            self._refuse_broken_file()
            self._study = self._optuna.create_study(
                storage=_database(storage), study_name=name, directions=directions, load_if_exists=True
            )
            self._claim(problem, name)
            self._refuse_changed_trials()
        except UserError:
            raise
        except ImportError as error:
            raise UserError(
                f"--storage {hidden(storage)}: its driver is not installed ({error.__cause__ or error}); "
                "install it, or leave --storage out for a file in the output folder"
            ) from None
        except (LookupError, RuntimeError, TypeError, ValueError) as error:  # from Optuna on damaged content
            raise self._damaged(str(error).splitlines()[0]) from None
        except Exception as error:  # every database has its own exceptions
            if not type(error).__module__.startswith(("sqlalchemy", "optuna", "alembic")):
                raise
            reason = str(error.__cause__ or error).splitlines()[0]
            raise UserError(
                f"--storage {hidden(storage)}: cannot be used ({reason}); check the URL, the rights and that "
                "the database runs"
            ) from None

    def start(self, first: Sequence[dict[str, float]]) -> None:
        """Queue ``first`` in a study that is still empty, without values that are out of range."""
        with self._alone():
            for values in first if not self._study.get_trials(deepcopy=False) else ():
                indices = self._indices(values)
                if indices is not None:
                    self._enqueue(indices)

    def ask(self, budget: int) -> OpenTrial | None:
        """The next trial, or None when the study has ``budget`` of them, whoever flies them."""
        with self._alone():
            self._requeue_abandoned()
            ended, running = len(self._those(self._state.COMPLETE)), len(self._those(self._state.RUNNING))
            if ended >= budget:
                return None
            self._study.sampler = self._sampler(ended, running)
            trial = self._study.ask()
            trial.set_user_attr("owner", {"host": socket.gethostname(), "process": os.getpid()})
            trials = self._study.get_trials(deepcopy=False)
            if sum(t.number < trial.number and t.state != self._state.FAIL for t in trials) >= budget:
                self._study.tell(trial, state=self._state.FAIL)
                return None
            indices = {p.field: trial.suggest_int(p.field, 0, len(p.values) - 1) for p in self._space}
            values = {p.field: p.values[indices[p.field]] for p in self._space}
            trial.set_user_attr("values", values)
            return OpenTrial(self._study, trial, values, self._rules)

    def trials(self) -> list[Trial]:
        """All that ended, in the order of their numbers."""
        ended = self._those(self._state.COMPLETE)
        return [Trial(trial.number, *(trial.user_attrs[key] for key in _TOLD)) for trial in ended]

    def _those(self, state: Any) -> list[Any]:
        return list(self._study.get_trials(deepcopy=False, states=(state,)))

    def _indices(self, values: dict[str, float]) -> dict[str, int] | None:
        """The index of each parameter's value; None where one is out of range."""
        try:
            return {p.field: p.values.index(values[p.field]) for p in self._space}
        except ValueError:
            return None

    @contextmanager
    def _alone(self) -> Iterator[None]:
        """Keep other processes from asking. SQLite locks no rows, so two would get the same waiting trial."""
        if not self._locks:
            yield
            return
        with Path(f"{self._file}.lock").open("a") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            yield

    def _requeue_abandoned(self) -> None:
        """Fail the trials that a process left when it died, and queue their values again."""
        unclaimed = self._unclaimed()
        for trial in self._those(self._state.RUNNING):
            is_claimed = "owner" in trial.user_attrs
            if _is_abandoned(trial) if is_claimed else trial.number in unclaimed:
                told = trial.user_attrs.get("values")
                if told is not None and trial.params != self._indices(told):
                    raise self._damaged(f"trial {trial.number} is not what was written")
                self._study.tell(trial.number, state=self._state.FAIL, skip_if_finished=True)
                if len(trial.params) == len(self._space):
                    self._enqueue(trial.params)

    def _enqueue(self, indices: dict[str, int]) -> None:
        self._study.enqueue_trial(indices, user_attrs={_SEAL: _sha256(indices)})

    def _unclaimed(self) -> set[int]:
        """Numbers of the trials whose process died before it could claim them."""
        until_s = time.monotonic() + (0.0 if self._locks else _CLAIM_S)
        running = self._state.RUNNING
        while unclaimed := {t.number for t in self._those(running) if "owner" not in t.user_attrs}:
            if time.monotonic() >= until_s:
                break
            time.sleep(0.05)
        return unclaimed

    def _sampler(self, ended: int, running: int) -> Any:
        """Multi-objective TPE, seeded by the study's progress, so that one process alone repeats itself."""
        digest = hashlib.sha256(f"{self._seed} {ended} {running}".encode()).digest()
        with warnings.catch_warnings():  # constraints_func is the one way that Optuna 4 and 5 share
            warnings.simplefilter("ignore")
            return self._optuna.samplers.TPESampler(
                seed=int.from_bytes(digest[:4], "big"),
                n_startup_trials=_RANDOM_TRIALS,
                multivariate=True,
                constant_liar=True,
                constraints_func=lambda trial: trial.user_attrs["violations"],
            )

    def _refuse_broken_file(self) -> None:
        """Let SQLite check its tables and indices."""
        if not self._file or not Path(self._file).is_file():
            return
        url = f"{Path(self._file).absolute().as_uri()}?mode=rw"
        try:
            with closing(sqlite3.connect(url, uri=True, timeout=60)) as file:
                ((found, *_), *_) = file.execute("PRAGMA integrity_check")
        except sqlite3.OperationalError:
            return  # locked, or cannot be opened, which opening the study reports
        except sqlite3.DatabaseError as error:
            found = str(error)
        if found != "ok":
            raise self._damaged(found)

    def _refuse_changed_trials(self) -> None:
        trials = self._study.get_trials(deepcopy=False)
        changed = [trial.number for trial in trials if self._is_changed(trial)]
        if changed:
            raise self._damaged(f"trial {changed[0]} is not what was written")
        if {t.number for t in trials} != set(range(len(trials))):
            raise self._damaged("trials are missing")

    def _is_changed(self, trial: Any) -> bool:
        """Whether a trial that waits or has ended differs from what was written. Others still change."""
        told, kept = trial.user_attrs, trial.system_attrs
        if trial.state == self._state.WAITING:
            return bool(told.get(_SEAL) != _sha256(kept["fixed_params"]))
        if trial.state != self._state.COMPLETE:
            return False
        one = self._optuna.distributions.IntDistribution
        return bool(
            told.get(_SEAL) != _digest(trial, trial.values)
            or trial.distributions != {p.field: one(0, len(p.values) - 1) for p in self._space}
            or kept.get("constraints", told["violations"]) != told["violations"]  # the sampler's copy
        )

    def _claim(self, problem: dict[str, Any], name: str) -> None:
        """Write the problem into a new study. Refuse a study of another one."""
        told = json.loads(json.dumps(problem))
        known = self._study.user_attrs.get("problem")
        if known is None:
            self._study.set_user_attr("problem", told)
            return
        other = [key for key in {**told, **known} if known.get(key) != told.get(key)]
        if other:
            raise UserError(
                f"{hidden(self._storage)}: study '{name}' is of another problem (differs: "
                f"{', '.join(other)}); give the same command to go on with it, or another --out or --study"
            )

    def _damaged(self, what: str) -> UserError:
        return UserError(
            f"{hidden(self._storage)}: is damaged, or of an older skysweep ({what}); restore the "
            "original, or write another --out or --study"
        )


class OpenTrial:
    """A trial that this process is flying."""

    def __init__(self, study: Any, trial: Any, values: dict[str, float], rules: RaceRules) -> None:
        self._study, self._trial, self._rules = study, trial, rules
        self.number: int = trial.number
        self.values = values

    def sign_of_life(self) -> None:
        """Tell other processes that this one works on it."""
        self._trial.set_user_attr("alive_unix_s", time.time())

    def close(
        self, missions: list[Outcome], flown: Outcomes, dropped: str | None, same_as: int | None
    ) -> Trial:
        told = {"missions": missions, "dropped": dropped, "same_as": same_as}
        for key, value in (told | {"violations": self._rules.violations(flown)}).items():
            self._trial.set_user_attr(key, value)
        objectives = list(self._rules.objectives(flown))
        self._trial.set_user_attr(_SEAL, _digest(self._trial, objectives))
        self._study.tell(self._trial, objectives, skip_if_finished=True)
        return Trial(self.number, self.values, missions, dropped, same_as)


def hidden(storage: str) -> str:
    """The URL without its password."""
    head, at, tail = storage.rpartition("@")
    scheme, slashes, user = head.partition("://")
    return f"{scheme}{slashes}{user.split(':')[0]}{at}{tail}" if at else storage


def _digest(trial: Any, objectives: Sequence[float]) -> str:
    told = {key: trial.user_attrs[key] for key in _SEALED}
    return _sha256([trial.number, trial.params, told, list(objectives)])


def _sha256(told: Any) -> str:
    return hashlib.sha256(json.dumps(told, sort_keys=True).encode()).hexdigest()


def _optuna() -> Any:
    try:
        import optuna
    except ImportError:
        raise MissingExtraError("skysweep tune", "tune") from None
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    return optuna


@lru_cache(maxsize=4)
def _database(url: str) -> Any:
    """One connection per process. SQLite waits for the others instead of giving up."""
    options = {"connect_args": {"timeout": 60}} if url.startswith("sqlite") else {"pool_pre_ping": True}
    storage = partial(_optuna().storages.RDBStorage, url, engine_kwargs=options)
    try:
        return storage()
    except Exception as error:
        if not type(error).__module__.startswith("sqlalchemy"):
            raise
        time.sleep(1.0)  # another process was making the tables of a new database
        return storage()


def _is_abandoned(trial: Any) -> bool:
    owner = trial.user_attrs["owner"]
    if owner["host"] == socket.gethostname() and os.name == "posix":
        try:
            os.kill(owner["process"], 0)
        except ProcessLookupError:
            return True
        except PermissionError:
            pass
    alive_unix_s = trial.user_attrs.get("alive_unix_s", trial.datetime_start.timestamp())
    return bool(time.time() - alive_unix_s > _STALE_S)
