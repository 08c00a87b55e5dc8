"""The loop of every closed-loop simulation: plan once, then act and step the physics until the next plan is due.

It stands here only. In C MuJoCo it runs on the host over a batch of robots (`on_host`); in MJX it is compiled for one
robot (`compiled`). What plans and acts, and what steps, are arguments.
"""

from collections.abc import Callable
from typing import TypeVar

import jax

from agile_jax.simulation.sensed import Sensed

E = TypeVar("E")  # state of what plans and acts, for example `closed_loop.Episode`
W = TypeVar("W")  # state of the physics that is not sensed; a physics that keeps its own state has None
Carry = TypeVar("Carry")
Repeat = Callable[[Callable[[Carry], Carry], Carry, int], Carry]


def plan_cycle(
    plan: Callable[[E, Sensed], E],
    act: Callable[[E, Sensed], E],
    step: Callable[[W, E], tuple[W, Sensed]],
    world: W,
    episode: E,
    sensed: Sensed,
    acts: int,
    repeat: Repeat[tuple[W, E, Sensed]],
) -> tuple[W, E, Sensed]:
    """Simulate from one plan to the next.

    Args:
        plan: plans ahead from what is sensed.
        act: sets the torques of the next step.
        step: applies the torques that the episode holds for one time step.
        world: state of the physics that is not sensed.
        episode, sensed: before the plan.
        acts: time steps between two plans.
        repeat: `on_host` or `compiled`.

    Returns:
        World, episode and what is sensed, before the next plan.
    """
    episode = plan(episode, sensed)

    def act_and_step(carry: tuple[W, E, Sensed]) -> tuple[W, E, Sensed]:
        world, episode, sensed = carry
        episode = act(episode, sensed)
        world, sensed = step(world, episode)
        return world, episode, sensed

    return repeat(act_and_step, (world, episode, sensed), acts)


def on_host(function: Callable[[Carry], Carry], carry: Carry, times: int) -> Carry:
    """Call a function again and again."""
    for _ in range(times):
        carry = function(carry)
    return carry


def compiled(function: Callable[[Carry], Carry], carry: Carry, times: int) -> Carry:
    """The same, as one loop that JAX compiles."""
    return jax.lax.scan(lambda carry, _: (function(carry), None), carry, None, length=times)[0]
