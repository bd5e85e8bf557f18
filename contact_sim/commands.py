"""What the simulator does without the client, as commands."""

from __future__ import annotations

import typer

from contact_sim.campaign.command import campaign
from contact_sim.hil.command import hil
from contact_sim.recording.command import film

app = typer.Typer(
    help="A simulated drone. The real client flies it with drone-client fly --sim; this is the "
    "rest.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    add_completion=False,
    rich_markup_mode=None,  # at 80 columns its tables cut the names of flags
)
app.command()(hil)
app.command()(campaign)
app.command()(film)
