"""The page: text, tables and packed trials put into one HTML document."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from html import escape
from itertools import groupby
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

import rcbht_jax
from rcbht_jax._util.arms import title_among
from rcbht_jax._util.columns import measured
from rcbht_jax._util.digest import among
from rcbht_jax._util.printable import plural
from rcbht_jax.errors import InputError
from rcbht_jax.introspection.introspector import Introspector
from rcbht_jax.introspection.model import IntrospectionModel
from rcbht_jax.io.export.card import confounds
from rcbht_jax.io.export.dataset import Block, DataSet
from rcbht_jax.io.simulation import with_faults
from rcbht_jax.report.live_frames import alphabets
from rcbht_jax.report.live_page import asset, filled
from rcbht_jax.report.pack import infer_beliefs, pack
from rcbht_jax.report.results import Results, cells
from rcbht_jax.types import Recordings


@dataclass(frozen=True)
class Options:
    """Content of a report besides the data."""

    title: str = ""  # "" = what the axes measure, as "Wrench introspection"
    results: Results | None = None  # None = no table of results
    model: IntrospectionModel | None = None  # model whose beliefs are shown over time
    rate: float | Literal["auto"] = "auto"  # beliefs per second, see Introspector
    trials: tuple[str, ...] = ()  # names of the trials to show; () = evenly spaced ones
    most: int = 100  # largest number of recordings, where none are named


def page(data: DataSet, options: Options = Options(), progress: Callable[[int], None] = lambda _: None) -> str:
    """The whole report as HTML.

    Args:
        data: recordings with labels, see :func:`rcbht_jax.io.export.load`.
        options: content besides the data.
        progress: called with the number of recordings packed since the last call.

    Raises:
        InputError: an unknown trial, fewer than one trial, or a model for another sampling period or other axes.
    """
    rows = chosen(data.recordings, options)
    introspector = _introspector(data.recordings, options)
    shown = _shown(data, rows)
    abouts, blobs = [], []
    for row in range(len(rows)):
        beliefs = [] if introspector is None else infer_beliefs(introspector, shown.recordings, row)
        about, blob = pack(shown.recordings, shown.tracks, row, beliefs)
        abouts.append(about | {"arm_title": title_among(about["arm"], data.recordings.arm)})
        blobs.append(blob)
        progress(1)
    what = measured(data.recordings.axes, data.recordings.units)
    facts = {
        "dt": data.recordings.dt,
        "axes": data.recordings.axes,
        "units": data.recordings.units,
        **alphabets("", ""),
        "trials": abouts,
    }
    parts = {
        "TITLE": escape(options.title or f"{what.capitalize()} introspection"),
        "SECTIONS": _sections(options),
        "STYLE": asset("report.css"),
        "SUMMARY": _summary(data, len(rows)) + _about_model(data, rows, options.model),
        "RESULTS": "" if options.results is None else results_html(options.results),
        "FACTS": _script_json(facts),
        "BLOBS": "\n".join(f'<script type="text/plain" id="blob-{n}">{blob}</script>' for n, blob in enumerate(blobs)),
        "SCRIPT": asset("report.js", "report_draw.js"),
    }
    return filled("report.html", parts)


def chosen(recordings: Recordings, options: Options) -> NDArray[np.int64]:
    """Rows of the recordings in the browser.

    Raises:
        InputError: an unknown trial, or fewer than one trial.
    """
    unknown = set(options.trials) - set(recordings.trial.tolist())
    if unknown:
        raise InputError(f"There is no trial {', '.join(sorted(unknown))}.")
    if options.trials:
        return np.flatnonzero(np.isin(recordings.trial, options.trials))
    if options.most < 1:
        raise InputError(f"{options.most} trials cannot be shown; give one or more.")
    count = min(options.most, len(recordings))
    return np.unique(np.linspace(0, len(recordings) - 1, count).round().astype(np.int64))


def _shown(data: DataSet, rows: NDArray[np.int64]) -> Block:
    """Recordings of the browser; simulated ones with the fault that they were given."""
    block = data.rows(rows)
    columns = with_faults(data.recordings, data.simulation()).columns
    columns = {name: values[rows] for name, values in columns.items()}
    return replace(block, recordings=replace(block.recordings, columns=columns))


def _introspector(recordings: Recordings, options: Options) -> Introspector | None:
    if options.model is None:
        return None
    if abs(options.model.encoder.dt - recordings.dt) > 1e-6 * recordings.dt:
        raise InputError(
            f"The model was trained on samples {options.model.encoder.dt:g} s apart, the store's are "
            f"{recordings.dt:g} s apart; train one on this store."
        )
    options.model.check_axes(recordings.axes, recordings.units, "the store")
    return Introspector(options.model, options.rate)


def _sections(options: Options) -> str:
    """Links to the sections that the page has."""
    titles = {"data": "Data", "browser": "Trials"} | ({} if options.results is None else {"results": "Results"})
    return " ".join(f'<a href="#{place}">{title}</a>' for place, title in titles.items())


def _script_json(value: Any) -> str:
    """JSON that cannot end the script element around it, whatever the name of a trial."""
    return json.dumps(value, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")


def _summary(data: DataSet, shown: int) -> str:
    recordings = data.recordings
    samples = int(recordings.length.sum())
    outcomes = [f"{int((recordings.outcome == o).sum())} {o}" for o in np.unique(recordings.outcome).tolist()]
    sources = ", ".join(escape(source) for source in np.unique(recordings.source).tolist())
    rule = "fit" if data.tracks_attrs.get("config", {}).get("rule") == "fit" else "published"
    words = f"labels {escape(data.tracks_name)}, words by the {rule} rule{'s' * (rule != 'fit')}"
    labels = words if data.tracks_name else "no labels"
    seconds = samples * recordings.dt
    lasting = f"{seconds / 60:.1f} minutes" if seconds >= 60 else f"{seconds:.1f} s"
    warnings = "".join(f"<li>{escape(sentence)}</li>" for sentence in confounds(data))
    digest = escape(str(data.attrs.get("content_sha256", "not hashed"))[:12])
    browsed = f"{shown} of them {'is' if shown == 1 else 'are'}"
    if shown == len(recordings):
        browsed = "It is" if shown == 1 else "All of them are"
    return (
        f"<p>{plural(len(recordings), 'recording')} of {sources}: {', '.join(map(escape, outcomes))}; "
        f"{lasting} at {1 / recordings.dt:g} Hz; {labels}. "
        f"{browsed} in the browser below.</p>"
        f"<h3>Known confounds of this data</h3><ul>{warnings}</ul>"
        f'<p class="made">Made by rcbht-jax {escape(rcbht_jax.__version__)}; content {digest}.</p>'
    )


def _about_model(data: DataSet, rows: NDArray[np.int64], model: IntrospectionModel | None) -> str:
    """How to read the beliefs that are shown."""
    if model is None:
        return ""
    seen = int(among(data.digests[rows], model.digests).sum())
    if not len(model.digests):  # an older file
        trained = "Whether the model was trained on recordings in the browser is not known."
        if model.data_hash == data.data_hash():
            trained = "The model was trained on recordings of this store; it is not known on which."
    elif seen:
        trained = f"The model was trained on {seen} of the {plural(len(rows), 'recording')} in the browser: "
        trained += "its beliefs about those are optimistic."
    else:
        trained = "The model was trained on none of the recordings in the browser."
    arms = data.recordings.arm[rows]
    learned, others = title_among(model.arm, data.recordings.arm), int(((arms != model.arm) & (arms != "")).sum())
    if model.arm and learned and others:
        trained += f" It learned the {escape(learned)}: do not rely on its beliefs about the "
        trained += f"{plural(others, 'recording')} of another arm."
    return f"<p><strong>Beliefs:</strong> {trained} The start of each sub-task is given to it, from the store.</p>"


_HEADS = ("benchmark", "paper", "ours", "95 % interval", "best peer", "duration alone", "read with care")


def results_html(results: Results) -> str:
    """The table of results with footnotes, and the files and commands behind it."""
    notes = [flag for flag in results.notes if any(flag in row.flags for row in results.rows)]
    head = "".join(f'<th scope="col">{title}</th>' for title in _HEADS)
    body = []
    for group, rows in groupby(results.rows, key=lambda row: row.group):
        body.append(f'<tr class="group"><th scope="colgroup" colspan="{len(_HEADS)}">{escape(group)}</th></tr>')
        for row in rows:
            what, *values = cells(row)
            numbers = (notes.index(flag) + 1 for flag in row.flags)
            marks = " ".join(f'<a href="#note-{number}">{number}</a>' for number in numbers)
            written = "".join(f"<td>{escape(value) or '<i>none</i>'}</td>" for value in values)
            body.append(f'<tr><th scope="row">{escape(what)}</th>{written}<td>{marks}</td></tr>')
    footnotes = "".join(f'<li id="note-{n}">{escape(results.notes[flag])}</li>' for n, flag in enumerate(notes, 1))
    listed = "".join(
        f"<tr><td>{escape(one.file)}</td><td><code>{escape(one.command)}</code></td><td>{escape(one.date)}</td>"
        f"<td>{escape(one.machine)}</td></tr>"
        for one in results.sources
    )
    return (
        '<h2 id="results">Results</h2><div class="wide" role="region" tabindex="0" aria-label="results">'
        f"<table><caption>Accuracy unless named otherwise; none = not measured or not printed.</caption>"
        f"<thead><tr>{head}</tr></thead><tbody>{''.join(body)}</tbody></table></div><ol>{footnotes}</ol>"
        "<details><summary>Files and commands behind these numbers</summary>"
        '<div class="wide"><table><thead><tr><th scope="col">file</th><th scope="col">command</th>'
        f'<th scope="col">date</th><th scope="col">machine</th></tr></thead><tbody>{listed}</tbody></table></div>'
        "</details>"
    )
