"""What the values of a site file are handed to stages as."""

from __future__ import annotations

from .rows import SiteValue

SITE_TYPES = {
    SiteValue.CAPTURES: "wbflow_stages.types:Capture",
    SiteValue.MASK: "wbflow_stages.types:Capture",
    SiteValue.PRIVACY: "wbflow_stages.types:Privacy",
    SiteValue.LENS: "wbflow_stages.types:Lens",
    SiteValue.PLACEMENT: "wbflow_stages.types:Placement",
    SiteValue.SURVEY: "wbflow_stages.types:Survey",
    SiteValue.FILE: "wbflow_stages.types:Capture",
}
"""The type that a value of the site is handed over as."""
