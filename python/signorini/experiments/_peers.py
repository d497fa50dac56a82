"""Which peers take part."""

from __future__ import annotations

from signorini import peers
from signorini.experiments._report import Options


def taking_part(options: Options) -> tuple[tuple[peers.Peer, ...], dict[str, str]]:
    """The installed peers (none without --peers), and name -> version."""
    entries = peers.available() if options.with_peers else ()
    return entries, {entry.name: entry.version() for entry in entries}
