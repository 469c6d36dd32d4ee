"""What clients send: looked at before a job is started for it, by a process of its own."""

from __future__ import annotations

import base64
import binascii
import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator

from up_samp.model.errors import ProblemError, short

if TYPE_CHECKING:  # what reads problems is large, and not for the server's own process
    from up_samp.fleet.records import FleetRecords

ENDINGS = ((b"\x89PNG\r\n\x1a\n", ".png"), (b"P5", ".pgm"), (b"P2", ".pgm"))
"""How images begin, and what their files' names end in."""
MAP_NAME = "map.yaml"
"""What the problem's map is called inside a job."""
PROBLEM_NAME = "problem.yaml"
"""What the text of a problem is called in messages."""


class MapUpload(BaseModel):
    """An occupancy map inside a request: an image and what ROS's map_server says about it."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)
    image: str
    """A PNG or PGM, base64; a data URL is taken, too."""
    resolution: Annotated[float, Field(gt=0)]
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    negate: Literal[0, 1] = 0
    occupied_thresh: Annotated[float, Field(gt=0, lt=1)] = 0.65
    free_thresh: Annotated[float, Field(gt=0, lt=1)] = 0.196

    @field_validator("image")
    @classmethod
    def _is_image(cls, text: str) -> str:
        _decoded(text)
        return text

    def write(self, folder: Path, name: str) -> None:
        """Write the image and ``name`` (its YAML) into a folder."""
        data, ending = _decoded(self.image)
        image = Path(name).stem + ending
        (folder / image).write_bytes(data)
        (folder / name).write_text(
            f"image: {image}\nresolution: {self.resolution}\norigin: {list(self.origin)}\n"
            f"negate: {self.negate}\noccupied_thresh: {self.occupied_thresh}\n"
            f"free_thresh: {self.free_thresh}\n",
            encoding="utf-8",
        )


def _decoded(text: str) -> tuple[bytes, str]:
    """Return the bytes of a base64 image and its ending; raise ValueError where it is none."""
    body = text.partition("base64,")[2] if text.startswith("data:") else text
    try:
        data = base64.b64decode(body, validate=True)
    except (binascii.Error, ValueError) as error:
        raise ValueError(f"the image is no base64: {error}") from error
    for begin, ending in ENDINGS:
        if data.startswith(begin):
            return data, ending
    raise ValueError("the image is neither PNG nor PGM")


class ProblemUpload(BaseModel):
    """A problem and its map."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)
    problem: dict[str, Any] | str
    """As in a problem file, without its ``map``: an object, or the text of the file, YAML or JSON
    (then faults are told with their lines).
    """
    map: MapUpload


class PlanRequest(ProblemUpload):
    """A problem, its map, and how to solve it."""

    engine: Annotated[str, Field(max_length=40)] = "cpsat"
    """The scheduler."""
    timeout: Annotated[float, Field(gt=0)] = 60.0
    """Seconds for the search; the server may allow less."""
    seed: Annotated[int, Field(ge=0, lt=2**31)] = 0
    first_plan: bool = False
    """Stop at the first plan (else: go on until it is proven optimal)."""

    @field_validator("engine")
    @classmethod
    def _is_there(cls, name: str) -> str:
        from up_samp.scheduling.quirks import no_engine, schedulers

        if name not in schedulers():
            raise ValueError(no_engine(name, schedulers()))
        return name


class ValidateRequest(ProblemUpload):
    """A problem with its map, and a plan (as in a plan file) to judge."""

    plan: dict[str, Any]


REQUESTS: dict[str, type[ProblemUpload]] = {"plan": PlanRequest, "validate": ValidateRequest}
"""What is asked for, by the kind of its job."""


class RequestError(Exception):
    """A request is wrong; ``faults`` tells each: ``loc``, ``msg`` and ``type``, as in FastAPI."""

    def __init__(self, faults: list[dict[str, Any]]) -> None:
        self.faults = faults
        super().__init__("; ".join(f["msg"] for f in faults))


def read_request(kind: str, body: bytes) -> ProblemUpload:
    """Return a request's body as a request of that kind.

    :raises RequestError: where it is none.
    """
    try:
        data = json.loads(body, parse_constant=_finite, parse_float=_finite)
    except RecursionError:
        raise _fault("json_invalid", "it is nested too deeply") from None
    except ValueError as error:  # a number of too many digits, too
        raise _fault("json_invalid", f"it is no JSON: {short(str(error), 200)}") from error
    from up_samp.fleet.fields import FILE_LIMITS

    if _is_deep(data, FILE_LIMITS.depth):
        raise _fault("json_invalid", f"it is nested more than {FILE_LIMITS.depth} deep")
    try:
        return REQUESTS[kind].model_validate(data)
    except ValidationError as error:
        raise RequestError(
            [
                {"loc": ["body", *_said(f["loc"])], "msg": f["msg"], "type": f["type"]}
                for f in error.errors(include_url=False, include_context=False, include_input=False)
            ]
        ) from error


def _said(loc: tuple[int | str, ...]) -> list[int | str]:
    return [short(part, 100) if isinstance(part, str) else part for part in loc]


def _finite(text: str) -> float:
    number = float(text)
    if not math.isfinite(number):
        raise ValueError(f"{short(text)} is no JSON number")
    return number


def _is_deep(data: Any, most: int) -> bool:
    """Return whether data are nested more than ``most`` deep."""
    level = [data]
    for _ in range(most):
        nested = [v for v in level if isinstance(v, dict | list)]
        level = [i for v in nested for i in (v.values() if isinstance(v, dict) else v)]
        if not level:
            return False
    return True


def _fault(kind: str, text: str, *place: int | str) -> RequestError:
    return RequestError([{"loc": ["body", *place], "msg": text, "type": kind}])


def records_of(request: ProblemUpload) -> FleetRecords:
    """Return the records of a request's problem.

    :raises RequestError: that tells place (and line) of each fault.
    """
    from up_samp.fleet.faults import NO_ROBOT, FleetError
    from up_samp.fleet.files import checked_records, read_problem_text

    problem = request.problem
    try:
        if isinstance(problem, str):
            records = read_problem_text(Path(PROBLEM_NAME), problem, MAP_NAME)
        else:
            records = checked_records(problem, MAP_NAME)
        if not records.robots:
            raise FleetError([NO_ROBOT])
    except FleetError as error:
        found = []
        for i, line in enumerate(str(error).splitlines()):
            path = error.faults[i].path if i < len(error.faults) else ()
            place = ["body", "problem", *_said(path)]
            found.append({"loc": place, "msg": short(line, 1000), "type": "problem"})
        raise RequestError(found) from error
    return records


def check_request(kind: str, body: bytes) -> ProblemUpload:
    """Return a request in which nothing is wrong that can be seen without planning; its map's files
    are written into the current folder.

    :raises RequestError: where something is.
    """
    from up_samp.geometry.maps import load_map

    request = read_request(kind, body)
    records_of(request)
    request.map.write(Path(), MAP_NAME)
    try:
        load_map(Path(MAP_NAME))
    except ProblemError as error:
        raise _fault("map", str(error), "map") from error
    return request
