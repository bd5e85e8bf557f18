"""The age of what is known is part of the margin: a silent link ends in a hold, a stop, a retreat.

    python examples/stale_link_retreat.py

A tip 0.5 m in front of the target gets no more results. Every tenth of a second: the phase, the
error ball, what the filter leaves of the barrier, and the commanded closing speed.
"""

from drone_client.cbf.filter import FilterInput, filter_command
from drone_client.cbf.settings import FilterSettings

MS = 1_000_000


def main() -> None:
    """Let the last measurement grow old for two seconds at the control rate."""
    settings = FilterSettings()
    x_m = 0.5
    print("  age [ms]  phase    delta [mm]  h certain [m]  closing [m/s]  tip at [m]")
    for tick in range(101):
        age_ms = round(tick * settings.period_s * 1e3)
        command = filter_command(
            FilterInput(
                tip_target=(x_m, 0.0, 0.0),
                velocity_tip_nominal_target=(-0.2, 0.0, 0.0),
                yaw_rate_nominal_radps=0.0,
                lever_arm_target=(-0.5, 0.0, 0.0),
                up_target=(0.0, 0.0, 1.0),
                age_ns=age_ms * MS,
                range_m=0.9,
                sigma_m=0.002,
            ),
            settings,
        )
        if age_ms % 200 == 0:
            print(
                f"{age_ms:10}  {command.freshness:8} {command.delta_m * 1e3:10.1f} "
                f"{command.h_robust:14.3f} {-command.velocity_body_target[0]:14.3f} {x_m:11.3f}"
            )
        x_m += settings.period_s * command.velocity_body_target[0]


if __name__ == "__main__":
    main()
