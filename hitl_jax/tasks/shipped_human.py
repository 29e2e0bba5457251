"""The trained human of a task: what they expect, and their hands.

`hitl-jax human --env NAME` makes the two files, which stand in `humans/`.
"""

from hitl_jax.human import experience
from hitl_jax.human.actions import ACTION_SOURCES
from hitl_jax.human.danger import DANGER_MODELS
from hitl_jax.human.part import HumanPart
from hitl_jax.human.trained_walker import FILE, trained_hands

_PACKAGE = "hitl_jax.tasks"


def register_human(name: str, observation_size: int) -> dict[str, str]:
    """Registers a task's human, as danger model and as hands; files are read when one is made.

    Args:
        name: of the human, and of the folder of the files.
        observation_size: O.

    Returns:
        What the task changes: `danger` and `human_actions`.
    """
    folder = f"humans/{name}"

    def experienced() -> HumanPart:
        expected = experience.expectation_of(f"{folder}/{experience.FILE}", _PACKAGE)
        return experience.expecting(expected, observation_size)

    danger, hands = f"{name}_experienced", f"{name}_trained"
    DANGER_MODELS.register(danger, f"as `experienced`, of {name}")(experienced)
    ACTION_SOURCES.register(hands, f"as `trained`, of {name}")(
        lambda action_size: trained_hands(f"{folder}/{FILE}", observation_size, _PACKAGE)
    )
    return {"danger": danger, "human_actions": hands}
