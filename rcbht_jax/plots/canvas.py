"""Shared by all figures: the canvas, colours of text, legends of labels, atomic saving."""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.font_manager import fontManager
from matplotlib.patches import Patch
from matplotlib.text import Text
from matplotlib.ticker import ScalarFormatter

from rcbht_jax._util.atomic import DISK_FULL, atomic_write
from rcbht_jax._util.printable import printable, room
from rcbht_jax._util.url_path import as_path
from rcbht_jax.errors import InputError
from rcbht_jax.features.spans import check_rate
from rcbht_jax.labels import COLORS, LAYERS, MEANING, name
from rcbht_jax.types import LabelTracks, Recordings

# Fields that would differ from run to run are not written.
_METADATA: dict[str, dict[str, None]] = {".png": {}, ".svg": {"Date": None}, ".pdf": {"CreationDate": None}}
# Fonts of Chinese, Japanese and Korean that systems bring; those that are installed supply what the usual font lacks.
_MORE_SCRIPTS = (
    "Noto Sans CJK JP", "Noto Sans CJK SC", "Noto Sans JP", "Noto Sans SC", "Noto Sans KR", "Source Han Sans",
    "IPAexGothic", "IPAGothic", "TakaoGothic", "VL Gothic", "WenQuanYi Zen Hei", "WenQuanYi Micro Hei",
    "Droid Sans Fallback", "NanumGothic", "Hiragino Sans", "PingFang SC", "Heiti TC", "Apple SD Gothic Neo",
    "Yu Gothic", "Meiryo", "MS Gothic", "Microsoft YaHei", "SimHei", "Malgun Gothic", "Arial Unicode MS",
)  # fmt: skip
LAYER_TITLES = {"primitive": "Primitives", "mc": "Motion compositions", "llb": "Low-level behaviours"}


def new_figure(inches: tuple[float, float], dpi: int) -> Figure:
    """An empty figure that draws itself in memory."""
    figure = Figure(figsize=inches, dpi=dpi, facecolor="white")
    FigureCanvasAgg(figure)
    return figure


class _Scale(ScalarFormatter):
    """Numbers of an axis; their common factor, and what is to be added, in a line each."""

    def get_offset(self) -> str:
        factor, offset = re.fullmatch(r"(1e\D?\d+)?(.*)", super().get_offset()).groups("")  # type: ignore[union-attr]
        return "\n".join(filter(None, (f"×{factor}" if factor else "", offset)))


def scale_in_margin(ax: Axes) -> None:
    """Write factor and offset of the vertical axis above its numbers, where nothing above the panel covers them."""
    scale = _Scale()
    scale.set_powerlimits((-3, 6))  # longer numbers would push the axis's name out of the figure
    ax.yaxis.set_major_formatter(scale)
    ax.yaxis.get_offset_text().set(x=-0.004, ha="right", va="bottom", fontsize=8, linespacing=1.0)


def plain(text: str) -> str:
    r"""A name of other people's data as text of a figure, where dollar signs would enclose a formula.

    >>> plain("a$b$")
    'a\\$b\\$'
    """
    return printable(text).replace("$", r"\$")


def cut(text: str, letters: int) -> str:
    """A text that takes the room of so many letters at most: names of a series differ at the end, so its middle goes.

    >>> cut("operator", 8), cut("operators", 8), room(cut("\ud798" * 8, 8))
    ('operator', 'oper…ors', 7)
    """
    kept, shown = min(len(text), letters), text
    while room(shown) > letters:
        kept -= 1
        shown = f"{text[: kept - kept // 2]}…{text[len(text) - kept // 2 :]}"
    return shown


def stacked(spans: Iterable[tuple[float, float]], most: int) -> list[int | None]:
    """The lowest row for each text in which it does not overlap those before it; None = in none of the rows.

    Args:
        spans: left and right end of each text.
        most: number of rows.

    >>> stacked([(0, 2), (1, 3), (2, 4), (1, 2)], 2)
    [0, 1, 0, None]
    """
    ends: list[float] = []
    rows: list[int | None] = []
    for left, right in spans:
        row = next((row for row, end in enumerate(ends) if end <= left), len(ends))
        rows.append(row if row < most else None)
        if row < most:
            ends[row : row + 1] = [right]
    return rows


def check_rows(recordings: Recordings, tracks: LabelTracks) -> None:
    """Check that the tracks belong to the recordings.

    Raises:
        InputError: they differ in number or rate, or a track is not ``[recording, axis, slot]``.
    """
    check_rate(tracks, recordings.dt, "the recordings are of")
    axes = len(recordings.axes)
    for layer in LAYERS:
        shape = np.shape(getattr(tracks, layer).label)
        if len(shape) != 3 or shape[:2] != (len(recordings), axes):
            expected = f"[{len(recordings)} recordings, {axes} axes, slots]"
            raise InputError(f"{layer} labels have shape {shape}; expected {expected}.")


def text_color(color: str) -> str:
    """Black or white, whichever contrasts more with ``color``."""
    red, green, blue = to_rgb(color)
    return "black" if 0.299 * red + 0.587 * green + 0.114 * blue > 0.5 else "white"


def label_legend(figure: Figure, layer: str, codes: Iterable[int], anchor: tuple[float, float], columns: int) -> None:
    """A legend of the given labels of one layer, its lower left corner at ``anchor`` (figure coordinates)."""
    handles = [
        Patch(
            facecolor=COLORS[layer][code - 1],
            edgecolor="0.4",
            linewidth=0.5,
            label=f"{name(layer, code)}  {MEANING[layer][code - 1]}",
        )
        for code in sorted(codes)
    ]
    legend = figure.legend(
        handles=handles,
        loc="lower left",
        bbox_to_anchor=anchor,
        ncols=columns,
        title=LAYER_TITLES[layer],
        fontsize=10,
        title_fontsize=10.5,
        frameon=False,
        borderpad=0,
        columnspacing=1.2,
        handlelength=1.4,
        labelspacing=0.3,
        alignment="left",
    )
    legend.set_gid(f"legend-{layer}")


def check_suffix(path: Path, others: tuple[str, ...] = ()) -> str:
    """The suffix of a figure's file, which decides its format, in lower case.

    Args:
        path: of the file.
        others: suffixes that the caller also accepts, not of figures; the error message names them.

    >>> check_suffix(Path("trial.PNG"))
    '.png'

    Raises:
        InputError: the suffix is unknown.
    """
    suffix = path.suffix.lower()
    if suffix not in _METADATA:
        raise InputError(f"{path} does not end in {', '.join((*_METADATA, *others))}; the suffix decides the format.")
    return suffix


def _supply_scripts(figure: Figure) -> None:
    """Texts beyond ASCII take what their font lacks from installed fonts of other scripts."""
    texts = [text for text in figure.findobj(Text) if not text.get_text().isascii()]
    installed = {font.name for font in fontManager.ttflist} if texts else set()
    for text in texts:
        text.set_fontfamily([*text.get_fontfamily(), *(name for name in _MORE_SCRIPTS if name in installed)])


@contextmanager
def _letters_in_one_warning() -> Iterator[None]:
    """Replace the warnings of single letters that no font has by one warning of all of them."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.filterwarnings("always", r"Glyph \d+ .* missing from font", UserWarning)
        yield
    lost = [re.match(r"Glyph (\d+)", str(one.message)) for one in caught]
    for one in (one for one, letter in zip(caught, lost, strict=True) if letter is None):
        warnings.warn_explicit(one.message, one.category, one.filename, one.lineno)
    if letters := "".join(sorted({chr(int(letter[1])) for letter in lost if letter})):
        warnings.warn(f"No installed font has the letters {letters}; install one, such as Noto Sans CJK.", stacklevel=4)


def lay_out(figure: Figure) -> None:
    """Compute where everything will be, without drawing it."""
    _supply_scripts(figure)
    with _letters_in_one_warning():
        figure.draw_without_rendering()


def save(figure: Figure, path: Path | str) -> None:
    """Write a figure as PNG, SVG or PDF, by the suffix of ``path``; an existing file is replaced.

    >>> save(new_figure((4.0, 3.0), 100), Path("empty.png"))

    Raises:
        InputError: the suffix is unknown, the folder does not exist, or the file cannot be written.
        OSError: the disk is full.
    """
    path = as_path(path)
    suffix = check_suffix(path)
    if not path.parent.is_dir():
        raise InputError(f"{path.parent} is not a folder; create it first, or choose another place for {path.name}.")
    if path.is_dir():
        raise InputError(f"{path} is a folder; choose another name for the figure.")
    _supply_scripts(figure)
    try:
        with atomic_write(path) as draft, _letters_in_one_warning():
            figure.savefig(draft, format=suffix[1:], metadata=_METADATA[suffix])
    except OSError as error:
        if error.errno in DISK_FULL:
            raise
        raise InputError(f"{path} cannot be written: {error.strerror or error}.") from error
