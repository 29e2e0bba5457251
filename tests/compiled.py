"""The team's functions, each one program: op by op, every new shape would be compiled alone."""

import jax

from hitl_jax.learner import replay
from hitl_jax.team import agent as agents

init = jax.jit(agents.init, static_argnums=0)
update = jax.jit(agents.update, static_argnums=(0, 5))
update_boundary = jax.jit(agents.update_boundary, static_argnums=0)
learn = jax.jit(agents.learn, static_argnums=(0, 5))
draw = jax.jit(replay.draw, static_argnums=(1, 4, 5))
read = jax.jit(replay.read, static_argnums=1)
sample_boundary = jax.jit(replay.sample_boundary, static_argnums=(1, 4))
