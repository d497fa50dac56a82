"""Other people's solvers on our problems, judged by our certificate. All are optional: extra `peers`.

`available()` are those installed here; each is a Peer with a name, a version and
`solve(problem, law="ncp", tolerance=1e-6, max_iterations=...)`, which returns a PeerSolution.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from signorini.peers import clarabel, pinocchio, scs, siconos
from signorini.peers._common import PeerSolution, PeerUnavailableError

__all__ = ["PEERS", "Peer", "PeerSolution", "PeerUnavailableError", "available", "named"]


@dataclass(frozen=True)
class Peer:
    """A solver by name: solve(problem, law, tolerance, max_iterations) -> PeerSolution, the laws it knows, and
    version(), which raises PeerUnavailableError where it is not installed."""

    name: str
    solve: Callable[..., PeerSolution]
    version: Callable[[], str]
    laws: tuple[str, ...] = ("ncp", "ccp")


PEERS: tuple[Peer, ...] = (
    Peer("scs", scs.solve, scs.version),
    Peer("clarabel", clarabel.solve, clarabel.version),
    Peer("pinocchio-admm", pinocchio.solve_admm, pinocchio.version),
    Peer("pinocchio-pgs", pinocchio.solve_pgs, pinocchio.version, ("ncp",)),
    *(
        Peer(f"siconos-{method}", partial(siconos.solve, method=method), siconos.version, ("ncp",))
        for method in siconos.METHODS
    ),
)


def named(name: str) -> Peer:
    """The peer of that name, installed or not. Raises KeyError with the names there are."""
    for peer in PEERS:
        if peer.name == name:
            return peer
    raise KeyError(f'"{name}" is none of {", ".join(peer.name for peer in PEERS)}')


def available() -> tuple[Peer, ...]:
    """The peers that are installed here."""

    def installed(peer: Peer) -> bool:
        try:
            peer.version()
        except PeerUnavailableError:
            return False
        return True

    return tuple(peer for peer in PEERS if installed(peer))
