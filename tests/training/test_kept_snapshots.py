"""Which snapshots a saved run has, and which are still to come: of today's saves and older ones."""

import numpy as np
import pytest
from example_saves import make_saved
from paper_team import paper_hyper

from hitl_jax.config import Method, hyper_for
from hitl_jax.evaluation.trials import milestones
from hitl_jax.training.run_spec import Run, RunSpec
from hitl_jax.training.saved_run import facts_of, restore_record


def _restored(ended, kept, told):
    """A run of 400 episodes, of which some had ended when it was saved with so many snapshots."""
    hyper = hyper_for(Method.HITL_AC, paper_hyper())
    run = Run(RunSpec(Method.HITL_AC, 3, hyper, 400, milestones(400)), 0)
    facts = {"episodes": [{}] * ended} | told
    saved = make_saved(ticks=9, new=0)._replace(
        snapshots=np.zeros((kept, 2)), boundaries=np.arange(kept, dtype=np.float32)
    )
    restore_record(run, saved._replace(facts=saved.facts | facts), [None] * kept)
    return run


def test_snapshots_are_kept_at_the_twentieths():
    assert milestones(400) == tuple(range(20, 400, 20))
    assert milestones(3) == (1, 2)
    assert milestones(1) == ()


def test_todays_saves_go_on_as_they_began():
    run = _restored(250, 12, {"snapshots": [*range(20, 250, 20)]})
    assert [kept.episode for kept in run.snapshots] == [*range(20, 250, 20)]
    assert run.spec.snapshots == milestones(400)
    assert facts_of(run, begun=True)["snapshots"] == [*range(20, 250, 20)]


@pytest.mark.parametrize(("ended", "kept"), [(250, (80, 160, 240)), (239, (80, 160)), (70, ())])
def test_older_saves_keep_what_they_have_and_skip_what_is_past(ended, kept):
    run = _restored(ended, len(kept), {})
    assert [snapshot.episode for snapshot in run.snapshots] == [*kept]
    assert run.snapshots == [] or run.snapshots[0].boundary == 0.0
    assert run.spec.snapshots == (*kept, *(point for point in milestones(400) if point > ended))
