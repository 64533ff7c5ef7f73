"""What the page says of a running simulation, in sentences."""

from __future__ import annotations

import numpy as np

from napsp import envs as tasks
from planners.app.studio.opening import period_of
from planners.app.studio.trial import Scenery

RECENT = 10  # control steps that are summed up


def progress(scenery: Scenery, seed: int, running: bool) -> str:
    """Where the episode stands."""
    length = tasks.episode_length(scenery.session.env_name)
    there = ", **at the goal**" if scenery.reached else ""
    state = "running" if running else "paused"
    after = f" (an episode has {length})" if scenery.number > length else f" of {length}"
    return f"**{state}**: seed {seed}, step {scenery.number}{after}{there}"


def goal(scenery: Scenery) -> str:
    """The goal, as the option that plans for it."""
    return f"`--goal {' '.join(f'{number:.3f}' for number in scenery.goal)}`"


def lateness(scenery: Scenery, realtime: bool) -> str:
    """Which way the simulation keeps time, and how late its plans are."""
    way = "In real time with the newest plan" if realtime else "The simulation waits for its plans"
    lived = scenery.lived[-RECENT:]
    if not lived:
        return f"{way}."
    period = 1e3 * period_of(scenery.session)
    took = float(np.median([one.step.plan_ms for one in lived]))
    if realtime:
        steps, late = np.mean([one.late_steps for one in lived]), np.mean([one.late_ms for one in lived])
        horizon = scenery.session.horizon
        gone = sum(one.late_steps >= horizon for one in lived)
        held = f"; {gone} of the last {len(lived)} steps had none left and held still" if gone else ""
        return f"{way}: {steps:.1f} steps ({late:.0f} ms) late, planned in {took:.0f} ms{held}."
    rate = f"{took - period:.0f} ms more than a control period" if took > period else "within a control period"
    return f"{way}: {took:.0f} ms each, {rate} of {period:.0f} ms."
