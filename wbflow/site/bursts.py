"""To which night a capture belongs: the date in its name, unless it is of a burst that began before midnight."""

from __future__ import annotations

import datetime
import itertools
import zoneinfo
from collections.abc import Iterable

BURST_GAP = datetime.timedelta(minutes=10)
"""Captures further apart are not of one burst.  A larger gap would join captures that are taken regularly through the day."""
LONGEST_BURST = datetime.timedelta(hours=2)
"""A longer series of captures is no burst but a record of the whole day, which midnight divides."""

BurstEnds = dict[datetime.date, datetime.datetime]
"""By date: when the burst that crosses the midnight at the beginning of that date ends."""


def burst_ends(moments: Iterable[datetime.datetime], zone: zoneinfo.ZoneInfo | None = None) -> BurstEnds:
    """The bursts that cross a midnight, from the times of the captures of all cameras of a site together.

    Together, because cameras take the pictures of one burst at slightly different times: those of one camera may all lie after
    midnight.

    moments: local times.  zone: of these times, so that clocks that are changed at midnight make no gap.
    """

    def absolute(moment: datetime.datetime) -> datetime.datetime:
        return moment.replace(tzinfo=zone or datetime.UTC).astimezone(datetime.UTC)

    # 1. Bursts: captures that follow each other closely.
    bursts: list[list[datetime.datetime]] = []
    for moment in sorted(set(moments), key=absolute):
        if bursts and absolute(moment) - absolute(bursts[-1][-1]) <= BURST_GAP:
            bursts[-1].append(moment)
        else:
            bursts.append([moment])
    # 2. Those that begin on one day and end on the next.
    ends: BurstEnds = {}
    for burst in bursts:
        first = burst[0]
        last = burst[-1]
        if first.date() < last.date() and absolute(last) - absolute(first) <= LONGEST_BURST:
            ends[last.date()] = last
    return ends


def night_of(moment: datetime.datetime, ends: BurstEnds) -> datetime.date:
    """The night of a capture: the day on which its burst began."""
    date = moment.date()
    end = ends.get(date)
    if end is not None and moment <= end:
        return date - datetime.timedelta(days=1)
    return date


def neighbours(date: datetime.date) -> list[datetime.date]:
    """The dates whose captures may belong to a night, or to the bursts at its beginning and end."""
    return [date + datetime.timedelta(days=days) for days in (-1, 0, 1)]


def longest_gap(moments: Iterable[datetime.datetime]) -> tuple[datetime.datetime, datetime.datetime] | None:
    """The two successive captures that are furthest apart; None if there are fewer than two."""
    ordered = sorted(moments)
    if len(ordered) < 2:
        return None
    return max(itertools.pairwise(ordered), key=lambda pair: pair[1] - pair[0])
