"""Episodes as a Minari dataset (https://minari.farama.org), which Minari writes and reads."""

import contextlib
import os
import pathlib
import shutil
import warnings
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from hitl_jax.errors import InvalidValue, ResultsError, said_by
from hitl_jax.exchange.played import Played, Source
from hitl_jax.tasks import task_of

_ROOT = "MINARI_DATASETS_PATH"

_NO_SEED = -1

INFOS = ("boundary", "alarmed", "dangerous", "human_action", "judged")
"""Of the info of a step, beside Minari's columns. As gymnasium has it, the first entry of each
belongs to the reset: it is NaN or false."""


def require_id(dataset: str) -> None:
    """Refuses what Minari would not take as the name of a dataset.

    Raises:
        InvalidValue: one line.
        ImportError: one line that says what to install.
    """
    _import()
    from minari.dataset.minari_dataset import parse_dataset_id

    try:
        if parse_dataset_id(dataset)[2] is None:
            raise ValueError("it has no version")
    except (ValueError, TypeError) as error:
        raise InvalidValue("id", dataset, f"must be like walker/session-v0: {error}") from error


def write(root: pathlib.Path, dataset: str, source: Source) -> tuple[int, int]:
    """Writes a dataset.

    Args:
        root: folder of Minari's datasets.
        dataset: its name, `namespace/name-v0`.
        source: the episodes.

    Returns:
        How many episodes and steps it has.

    Raises:
        ResultsError: one line, if there is nothing to write, or it is there already, or cannot be
            written.
    """
    import gymnasium

    minari, env_id = _import(), task_of(source.env).env_id
    if (root / dataset).exists():
        raise ResultsError(f"{root / dataset}: is there already")
    episodes = list(source.episodes)
    if not episodes:
        raise ResultsError(f"there are no {source.told}")
    try:
        with (
            _in(root),
            warnings.catch_warnings(action="ignore"),  # Of an evaluation, an author's address, ...
            contextlib.closing(gymnasium.make(env_id)) as env,
        ):
            minari.create_dataset_from_buffers(
                dataset_id=dataset,
                buffer=_buffers(episodes, env_id, env.action_space),
                env=env,
                # Played in float32, and not within all bounds that environments give.
                observation_space=gymnasium.spaces.Box(
                    -np.inf, np.inf, episodes[0].observations.shape[1:], np.float32
                ),
                action_space=env.action_space,
                algorithm_name="HITL-AC",
                author="hitl_jax",
                description=f"{source.told}, hitl_jax; infos: {', '.join(INFOS)}",
            )
    except BaseException as error:
        shutil.rmtree(root / dataset, ignore_errors=True)  # A half of one disturbs Minari.
        if isinstance(error, Exception):
            raise ResultsError(f"{root / dataset}: {said_by(error)}") from error
        raise
    return len(episodes), sum(len(one.rewards) for one in episodes)


def read(root: pathlib.Path, dataset: str) -> list[Played]:
    """Reads a dataset that `write` wrote; of one of others' nobody's judgements are known.

    Args:
        root: folder of Minari's datasets.
        dataset: its name.

    Raises:
        ResultsError: one line, if there is none, or it has no flat observations and actions.
    """
    from hitl_jax.envs.spaces import flat_size

    minari = _import()
    try:
        with _in(root), warnings.catch_warnings(action="ignore"):
            found = minari.load_dataset(dataset)
            for name in ("observation", "action"):
                flat_size(dataset, name, getattr(found, f"{name}_space"))
            low, high = found.action_space.low, found.action_space.high
            if not np.isfinite([low, high]).all():
                raise ValueError(f"its actions have no finite bounds, but {found.action_space}")
            told = found.storage.get_episode_metadata(found.episode_indices)
            seeds = [each.get("seed") for each in told]
            return [
                _played(one, f"{dataset} episode {one.id}", seed, low, high)
                for one, seed in zip(found, seeds, strict=True)
            ]
    except Exception as error:  # Whatever stands in the files.
        raise ResultsError(f"{root / dataset}: is no dataset to learn from: {error}") from error


def _played(episode: Any, name: str, seed: Any, low: np.ndarray, high: np.ndarray) -> Played:
    steps, infos = len(episode.rewards), episode.infos or {}
    flags = {
        flag: np.asarray(infos.get(flag, np.zeros(steps + 1)))[1:].astype(bool)
        for flag in INFOS
        if flag != "boundary"
    }
    boundary = np.asarray(infos.get("boundary", np.full(steps + 1, np.nan)), np.float32)[1:]
    shapes = {len(values) for values in flags.values()} | {len(boundary), len(episode.actions)}
    seen = np.asarray(episode.observations, np.float32)
    if shapes != {steps} or len(seen) != steps + 1:
        raise ValueError(f"{name}: its columns have different lengths")
    if not (np.isfinite(seen).all() and np.isfinite(episode.actions).all()):
        raise ValueError(f"{name}: holds numbers that are not finite")
    # Bounds of -1 and 1 change no digit.
    scaled = 2 * (episode.actions - low) / (high - low) - 1
    actions = episode.actions if (low == -1).all() and (high == 1).all() else scaled
    return Played(
        name=name,
        seed=_NO_SEED if seed is None or seed == "None" else int(seed),
        observations=seen,
        actions=np.asarray(actions, np.float32),
        rewards=np.asarray(episode.rewards, np.float32),
        terminated=np.asarray(episode.terminations, bool),
        truncated=np.asarray(episode.truncations, bool),
        boundary=boundary,
        **flags,
    )


def _buffers(episodes: Sequence[Played], env_id: str, action_space: Any) -> list[Any]:
    from minari.data_collector.episode_buffer import EpisodeBuffer

    from hitl_jax.envs.spaces import action_map

    scaled = action_map(env_id, action_space)
    return [
        EpisodeBuffer(
            id=place,
            seed=one.seed,
            observations=one.observations,
            actions=scaled(one.actions).astype(action_space.dtype),
            rewards=list(one.rewards),
            terminations=list(one.terminated),
            truncations=list(one.truncated),
            infos={
                "boundary": np.append(np.float32(np.nan), one.boundary).astype(np.float32),
                **{
                    name: np.append(False, getattr(one, name)).astype(bool)
                    for name in INFOS
                    if name != "boundary"
                },
            },
        )
        for place, one in enumerate(episodes)
    ]


@contextlib.contextmanager
def _in(root: pathlib.Path) -> Iterator[None]:
    """Minari's folder within a `with`."""
    before = os.environ.get(_ROOT)
    os.environ[_ROOT] = str(root.resolve())
    try:
        yield
    finally:
        os.environ.pop(_ROOT)
        if before is not None:
            os.environ[_ROOT] = before


def _import() -> Any:
    try:
        import minari
    except ImportError as error:
        raise ImportError('Minari is missing: pip install -e ".[minari]"') from error
    return minari
