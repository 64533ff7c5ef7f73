"""Sessions that the studio can show: it draws MuJoCo's scene, in MuJoCo's time."""

from __future__ import annotations

from napsp.errors import UserError
from planners.app.session import Session
from planners.app.studio.choices import Choices


def open_session(choices: Choices) -> Session:
    """The session that was chosen.

    Raises:
        UserError: what is chosen is impossible, or is simulated without MuJoCo.
    """
    session = Session.open(choices.plan, choices.run)
    if session.env.unwrapped.model is None:
        session.close()
        raise UserError(
            f"the studio draws MuJoCo's scenes, and {session.env_name} has none; plan in it by "
            f"python -m planners.{choices.plan.planner}"
        )
    return session


def period_of(session: Session) -> float:
    """Seconds of simulated time that one action lasts."""
    period = session.control_period
    assert period is not None, "open_session lets none in without a clock"
    return period
