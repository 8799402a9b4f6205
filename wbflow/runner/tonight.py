"""Finds the facts of a night: its captures, which cameras are stale, its reference.  `run`, `status` and `check` begin here."""

from __future__ import annotations

import dataclasses

from ..cache.memo import Digests, EarlierCaptures
from ..cache.store import Cache
from ..records.reference import BadReference, read_reference
from ..reference.compatibility import calibration_change, incompatibility
from ..site.captures import expected, find_captures, find_named, list_store, night, when_complete
from ..site.models import Site
from ..site.stale_cameras import find_stale
from .night import Night, NightFiles
from .options import Options


def read_night(site: Site, options: Options) -> Night:
    """Find a night's captures and its reference; nothing is written."""
    work = site.work_folder
    digests = Digests(work.captures_memo)
    earlier = EarlierCaptures(work.delivered_memo)
    list_store(site)  # first: the mirror of an object store is searched like any folder from here on
    date = night(site, options.date)
    # a camera may still be writing; what stands still is complete
    captures, growing = when_complete(find_captures(site, date, digests), digests)
    fresh = find_stale(site, date, captures, digests, earlier)
    missing = {}
    for camera in site.cameras:
        if not fresh.captures[camera.id]:
            name = expected(site, camera, date).replace(f"{site.captures.root}/", "")
            missing[camera.id] = options.not_captured.get(camera.id) or f"there is no file {name}"
    found = Night(
        site,
        date,
        site.active_stages(options.until),
        Cache(work),
        NightFiles(fresh.captures, find_named(site, digests), digests, earlier, growing),
        date_stated=options.date is not None,
        until=options.until,
        force=frozenset(options.force),
        missing=missing,
        stale=fresh.stale,
        notes=fresh.notes,
    )
    if site.settings.pin == "none":
        return found
    return _with_reference(found)


def _with_reference(found: Night) -> Night:
    """The night with its reference, or with the reason why that cannot be used."""
    try:
        reference = read_reference(found.cache.work)
    except BadReference as error:
        return dataclasses.replace(found, reference_fault=error.what)
    if reference is None:
        return found
    fault = incompatibility(reference, found)
    if fault:
        # the verdict tells how lenses and poses differ: it may have been a mistake
        change = calibration_change(reference.cameras, found.site)
        return dataclasses.replace(found, reference_fault=fault, calibration_change=change)
    return dataclasses.replace(found, reference=reference)
