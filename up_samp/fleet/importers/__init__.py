"""Problem files from others' files: maps, layouts, scenarios and shops.

Each importer writes a map and a ``problem.yaml`` into a folder and returns an :class:`Imported`
that tells what it had to assume; the file is then yours to edit.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

from shapely.errors import ShapelyError

from up_samp.extensions import parts
from up_samp.fleet.importers.common import Imported, Importer, Options, wrong
from up_samp.fleet.importers.grids import import_league, import_movingai
from up_samp.fleet.importers.layouts import import_lif, import_rmf
from up_samp.fleet.importers.outlines import import_dxf, import_svg, map_from_polygons
from up_samp.fleet.importers.shops import import_fjs, import_jsplib
from up_samp.model import ProblemError, UnsupportedError
from up_samp.model.errors import short

IMPORTERS: Mapping[str, Importer] = {
    "movingai": Importer(import_movingai, "a Moving AI map or scenario", (".map", ".scen")),
    "league": Importer(import_league, "a problem of the League"),
    "lif": Importer(import_lif, "a LIF layout", (".lif.json", ".lif")),
    "rmf": Importer(import_rmf, "an RMF building map", (".building.yaml",)),
    "jsplib": Importer(import_jsplib, "a job shop", (".jsp",)),
    "fjs": Importer(import_fjs, "a flexible job shop", (".fjs",)),
    "dxf": Importer(import_dxf, "DXF", (".dxf",)),
    "svg": Importer(import_svg, "SVG", (".svg",)),
}
"""Importers by the name of what they read."""


def import_file(
    source: Path, folder: Path, kind: str | None = None, options: Options = Options()
) -> Imported:
    """Import ``source`` into ``folder``; ``kind`` is found by the file's ending if it is None.

    :raises UnsupportedError: where the kind is not known.
    :raises ProblemError: that names the file, where it is not of that kind, or wrong.
    """
    known = {**IMPORTERS, **parts("importers")}
    if kind is None:
        name = source.name.lower()
        kind = next((k for k, how in known.items() if name.endswith(how.endings)), None)
    if kind is None or kind not in known:
        raise UnsupportedError(f"'{source}': say what it is (--kind): {', '.join(known)}")
    how = known[kind]
    try:
        return how.read(source, folder, options)
    except UnsupportedError:
        raise
    except ProblemError as error:
        pieces = str(error).split(str(source))
        text = str(source).join(_LONG.sub(lambda word: short(word[0]), part) for part in pieces)
        if len(pieces) > 1 and text == str(error):
            raise
        named = text if len(pieces) > 1 else f"{source}: {text}"  # found in what was made of it
        raise ProblemError(named) from error
    except _OTHER_SHAPE as error:
        said = f"{error} is not there" if isinstance(error, KeyError) else str(error)
        text = short(" ".join(said.split()) or type(error).__name__, 200)
        raise wrong(source, None, f"not readable as {how.title}: {text}") from error


_LONG = re.compile(r"\S{200,}")
"""Words of a file that are not told whole."""
_OTHER_SHAPE = (
    ArithmeticError,
    AttributeError,
    LookupError,
    RecursionError,
    TypeError,
    ValueError,
    ShapelyError,
)
"""What Python raises where data have another shape than their format says."""


__all__ = ["IMPORTERS", "Imported", "Importer", "Options", "import_file", "map_from_polygons"]
