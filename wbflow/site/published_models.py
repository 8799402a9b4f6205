"""Models of networks that others publish, and that a site file can name: what each is for, and where its file lies.

wbflow comes without weights, and only `wbflow models get` downloads any: a run needs no network.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from ..cache.checksum import sha256_of
from ..cache.untrusted import is_file

FOLDER_VARIABLE = "WBFLOW_MODELS"
"""Environment variable that names another folder for the files, such as one that several machines share."""
_RELEASE = "https://github.com/colmap/colmap/releases/download/3.13.0"
"""Where COLMAP publishes its models."""


@dataclass(frozen=True)
class PublishedModel:
    """A published model; its file has the same bytes everywhere."""

    name: str
    stage: str
    """The stage that reads it."""
    purpose: str
    licence: str
    """Licence of the weights, by its SPDX name."""
    size_bytes: int
    """Size as others report it: for people, and to see whether there is space.  The checksum decides."""
    sha256: str

    @property
    def url(self) -> str:
        """Address of the published file."""
        return f"{_RELEASE}/{self.name}.onnx"

    @property
    def path(self) -> Path:
        """Where the file lies on this machine, or belongs."""
        return models_folder() / f"{self.name}.onnx"

    @property
    def command(self) -> str:
        """The command that downloads it."""
        return f"wbflow models get {self.name}"

    def fault(self) -> str:
        """What is wrong with the file on this machine, in words; "" if it is there and whole."""
        if not is_file(self.path):
            return f"{self.name} is not in {self.path.parent}"
        digest = sha256_of(self.path)
        if not digest:
            return f"{self.path} cannot be read"
        if digest != self.sha256:
            size = self.path.stat().st_size
            return f"{self.path} is not the published file, or not all of it ({size:,} bytes, SHA-256 {digest[:12]}...)"
        return ""


PUBLISHED_MODELS = {
    model.name: model
    for model in (
        PublishedModel(
            "aliked-n16rot",
            "features",
            "learned keypoints for views far apart, of cameras on their side or upside down, too",
            "BSD-3-Clause",
            2_997_054,
            "39c423d0a6f03d39ec89d3d1d61853765c2fb6a8b8381376c703e5758778a547",
        ),
        PublishedModel(
            "aliked-n32",
            "features",
            "learned keypoints for views far apart, of upright cameras",
            "BSD-3-Clause",
            4_205_634,
            "a077728a02d2de1a775c66df6de8cfeb7c6b51ca57572c64c680131c988c8b3c",
        ),
        PublishedModel(
            "aliked-lightglue",
            "matches",
            "a learned matcher for the keypoints of ALIKED",
            "Apache-2.0",
            45_804_950,
            "b9a5de7204648b18a8cf5dcac819f9d30de1a5961ef03756803c8b86c2dceb8d",
        ),
        PublishedModel(
            "sift-lightglue",
            "matches",
            "a learned matcher for SIFT keypoints",
            "Apache-2.0",
            45_806_253,
            "e0500228472b43f92b3d36881a09b3310d3b058b56187b246cc7b9ab6429096e",
        ),
    )
}
"""The published models by name.  Licences: https://github.com/Shiaoming/ALIKED; those of the weights of LightGlue, whichever
keypoints they are for, https://github.com/cvg/LightGlue (issue 38)."""


def models_folder() -> Path:
    """The folder of the files: `$WBFLOW_MODELS`, else `wbflow/models` in the user's folder for data."""
    named = os.environ.get(FOLDER_VARIABLE)
    if named:
        return Path(named).expanduser().absolute()
    user_data = os.environ.get("XDG_DATA_HOME") or Path.home() / ".local" / "share"
    return Path(user_data).absolute() / "wbflow" / "models"
