"""What the belief strategy assumes, and what things cost it: ``search.parameters`` in a scenario."""

from __future__ import annotations

from pydantic import Field

from skysweep.scenarios.model import Model


class BeliefParameters(Model):
    """Costs are in seconds of search: how much longer one would search to avoid it."""

    missed_cost_s: float = Field(1000.0, gt=0, description="Cost of a victim that is rejected")
    alarm_cost_s: float = Field(400.0, gt=0, description="Cost of confirming something else")
    waiting_cost: float = Field(
        0.05,
        ge=0,
        le=1,
        description="Cost of a second that a victim waits to be found; with 0 the scan is never left",
    )
    confirm_probability: float = Field(
        0.95,
        gt=0.5,
        lt=1,
        description="From here on a candidate is confirmed as soon as it leaves the picture; with half of "
        "the remaining doubt at once",
    )
    target_share: float = Field(0.5, gt=0, lt=1, description="Prior share of candidates that are targets")
    share_weight: float = Field(
        4.0, gt=0, description="Weight of these priors, in candidates, against what the mission finds"
    )
    ghost_share: float = Field(
        0.2, gt=0, lt=1, description="Prior share of the other candidates that are nothing at all"
    )
    model_std: float = Field(
        0.2, ge=0, description="Standard deviation of the sensor model's own error, in scores"
    )
    lapse: float = Field(0.1, gt=0, lt=1, description="Least share of looks that miss whatever the score")
    check_speed_mps: float = Field(5.0, gt=0, le=20, description="Speed between candidates")
    n_missing: int | None = Field(
        None, ge=1, le=10000, description="How many are missing, where that is known"
    )
    end_at_success: float | None = Field(
        None,
        gt=0,
        lt=1,
        description="The search ends once so large a share of the missing is expected to be confirmed",
    )
    end_after_s: float | None = Field(
        None, gt=0, description="The search ends so many seconds after its first leg began"
    )
