"""What clients send: checked before anything is started."""

from __future__ import annotations

import base64
import binascii
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, field_validator

PNG = b"\x89PNG\r\n\x1a\n"


class MapUpload(BaseModel):
    """An occupancy map inside a request: a PNG and what ROS's map_server says about it."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)
    image: str
    """The PNG, base64; a data URL is taken, too."""
    resolution: Annotated[float, Field(gt=0)]
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    negate: Literal[0, 1] = 0
    occupied_thresh: Annotated[float, Field(gt=0, lt=1)] = 0.65
    free_thresh: Annotated[float, Field(gt=0, lt=1)] = 0.196

    @field_validator("image")
    @classmethod
    def _is_png(cls, text: str) -> str:
        _decoded(text)
        return text

    def write(self, folder: Path, name: str) -> None:
        """Write the image and ``name`` (its YAML) into a folder."""
        image = f"{Path(name).stem}.png"
        (folder / image).write_bytes(_decoded(self.image))
        (folder / name).write_text(
            f"image: {image}\nresolution: {self.resolution}\norigin: {list(self.origin)}\n"
            f"negate: {self.negate}\noccupied_thresh: {self.occupied_thresh}\n"
            f"free_thresh: {self.free_thresh}\n",
            encoding="utf-8",
        )


def _decoded(text: str) -> bytes:
    """Return the bytes of a base64 PNG; raise ValueError where it is none."""
    body = text.partition("base64,")[2] if text.startswith("data:") else text
    try:
        data = base64.b64decode(body, validate=True)
    except binascii.Error as error:
        raise ValueError(f"the image is no base64: {error}") from error
    if not data.startswith(PNG):
        raise ValueError("the image is no PNG")
    return data


MAP_NAME = "map.yaml"
"""What the problem's map is called inside a job."""


class PlanRequest(BaseModel):
    """A problem (as in a problem file, without its ``map``), its map, and how to solve it."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)
    problem: dict[str, Any]
    map: MapUpload
    engine: Annotated[str, Field(pattern=r"^[a-z0-9-]{1,40}$")] = "cpsat"
    timeout: Annotated[float, Field(gt=0)] = 60.0
    """Seconds for the search; the server may allow less."""
    seed: Annotated[int, Field(ge=0, lt=2**31)] = 0
    first_plan: bool = False
    """Stop at the first plan (else: go on until the makespan is proven optimal)."""

    @field_validator("problem")
    @classmethod
    def _names_no_file(cls, problem: dict[str, Any]) -> dict[str, Any]:
        if "map" in problem:
            raise ValueError("the problem must not name a map: it comes beside it, as 'map'")
        return problem


class ValidateRequest(BaseModel):
    """A problem with its map, and a plan (as in a plan file) to judge."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)
    problem: dict[str, Any]
    map: MapUpload
    plan: dict[str, Any]

    @field_validator("problem")
    @classmethod
    def _names_no_file(cls, problem: dict[str, Any]) -> dict[str, Any]:
        return PlanRequest._names_no_file(problem)
