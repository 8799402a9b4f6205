"""What cameras have delivered in earlier nights, by digest: a picture that comes again is not of tonight."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from .signed import Damaged, read_signed, write_signed

_OF = "captures of earlier nights"
NIGHTS = 60
"""So many are remembered."""


class Seen:
    """Digests of captures by camera and night (ISO 8601), kept in a signed file between runs."""

    def __init__(self, memo: Path) -> None:
        self._memo = memo
        self.damage: str | None = None
        """What was wrong with the memo, if anything was."""
        try:
            known = read_signed(memo, _OF)
        except Damaged as damage:
            self.damage = f"{damage.what}: what cameras have delivered before tonight is forgotten"
            known = None
        self._nights: dict[str, dict[str, list[str]]] = dict(known.get("cameras", {})) if known else {}
        self._changed = self.damage is not None

    def before(self, camera: str, night: str) -> dict[str, str]:
        """The newest earlier night of each digest that a camera has delivered."""
        earlier = sorted((date, found) for date, found in self._nights.get(camera, {}).items() if date < night)
        return {digest: date for date, found in earlier for digest in found}

    def note(self, camera: str, night: str, digests: Iterable[str]) -> None:
        """Remember what a camera delivers tonight.  A night that is run again is remembered as it is now."""
        nights = self._nights.setdefault(camera, {})
        found = sorted({digest for digest in digests if digest})
        if found and nights.get(night) != found:
            nights[night] = found
            self._nights[camera] = {date: nights[date] for date in sorted(nights)[-NIGHTS:]}
            self._changed = True

    def save(self) -> None:
        """Keep what was learnt.  Raises OSError."""
        if self._changed:
            write_signed(self._memo, _OF, {"cameras": self._nights})
            self._changed = False
