"""An episode looked at afterwards: `hitl-jax replay RESULTS --seed 3`.

Plays a recorded training episode again from its seed and actions, or a test episode from the saved
parameters, checks that its return is the recorded one, and makes a film of it.
"""

import dataclasses
import pathlib

import tyro

from hitl_jax.choices.checks import require
from hitl_jax.console.cli import checking_input, refusing
from hitl_jax.console.output import say
from hitl_jax.playback import film
from hitl_jax.playback.episodes import differences, env_of, playing_backend, require_repeatable
from hitl_jax.playback.load_trained import agent_of, load_trained, require_same_human
from hitl_jax.playback.replay import Phase, find_episode, find_run, make_film
from hitl_jax.results.folder import ResultsFolder
from hitl_jax.sweep.compile_cache import keep_programs
from hitl_jax.tasks import task_of


@dataclasses.dataclass(frozen=True)
class ReplayOptions:
    """Makes a film of an episode, and checks its return.

    Attributes:
        results: a folder that a sweep has written.
        method: srl, hitl-fix or hitl-ac.
        seed: the run's.
        phase: a `training` episode, or one of the `autonomous` or `assisted` test.
        episode: its number, from 1. By default of training the best one, of a test the first. Of
            training, a run's best episode and that of its first intervention are recorded.
        out: the film, .gif, or .mp4 (which needs the extra `video`). By default a .gif in
            RESULTS/replays.
        width: of the film, in pixels.
        human_policy: the file given to the sweep under this name, if there was one.
    """

    results: tyro.conf.Positional[pathlib.Path]
    method: str = "hitl-ac"
    seed: int = 0
    phase: Phase = "training"
    episode: int | None = None
    out: pathlib.Path | None = None
    width: int = 600
    human_policy: str | None = None


def main(options: ReplayOptions) -> int:
    """Plays, compares and draws.

    Args:
        options: which episode.

    Returns:
        The exit code: 0, or 1 if the return is another than the recorded one.

    Raises:
        BadInput: where there is no such episode.
    """
    with checking_input():
        require("width", options.width, at_least=100, at_most=2000)
        if options.out:
            film.require_format(options.out)
        folder = ResultsFolder(options.results)
        require_repeatable(folder)
        require_same_human(folder, options.human_policy)
        agent = agent_of(folder, options.human_policy)
    with refusing():
        key = find_run(folder, options.method, options.seed)
        keep_programs()
        found = find_episode(agent, folder, key, options.phase, options.episode)
        number = found.episode.episode
        name = f"{key.method}-seed-{key.seed}-{options.phase}-{number}"
        out = options.out or options.results / "replays" / f"{name}.gif"
        phase = "training" if options.phase == "training" else f"{options.phase} test"
        title = f"{key.method.upper()}, seed {key.seed}, {phase}, episode {number}"
        sees_risk, backend = agent.risk_learner is not None, playing_backend(folder)
        env_id = task_of(env_of(folder)).env_id
        params = load_trained(agent, folder, key)[1].behavior if sees_risk else None
        returned = make_film(agent, params, backend, env_id, found, out, title, options.width)
        print(out)
        again = f"{returned:.3f}"
        if returned == found.recorded:
            steps = len(found.episode.steps)
            print(f"its return is the recorded one, {again}, after {steps} steps")
            return 0
        if line := differences(folder, [key]):
            say(line)
    recorded = f"{found.recorded:.3f}"
    print(f"its return is {again}, the recorded one {recorded}: not the same episode")
    return 1
