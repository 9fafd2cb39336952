"""Kernels of a step from a profiler's trace."""

from __future__ import annotations

from typing import Any

from experiments.simulation import step_profile


def named(pid: int, tid: int | None, kind: str, name: str) -> dict[str, Any]:
    return {"ph": "M", "pid": pid, "name": kind, "args": {"name": name}} | ({} if tid is None else {"tid": tid})


def test_kernels_of_the_device_are_counted_by_what_they_do() -> None:
    names = [
        named(1, None, "process_name", "/device:GPU:0"), named(2, None, "process_name", "/host:CPU"),
        named(1, 7, "thread_name", "Stream #7(Compute)"), named(1, 8, "thread_name", "XLA Ops"),
        named(2, 7, "thread_name", "Stream of the host"),
        {"ph": "M", "pid": 1, "name": "process_sort_index", "args": {"sort_index": 1}},
    ]  # fmt: skip
    kernel = "_linesearch_iterative_kernel__locals__kernel_bed52587_cuda_kernel_forward"
    spans = [
        (1, 7, kernel, 6.0),
        (1, 7, kernel, 2.0),
        (1, 7, "memset32", 2.0),
        (1, 8, "op", 50.0),
        (2, 7, "call", 90.0),
    ]
    events = [{"ph": "X", "pid": pid, "tid": tid, "name": name, "dur": took} for pid, tid, name, took in spans]
    rows = step_profile.kernels([*names, *events, {}], 2)
    assert rows == {
        "linesearch_iterative_kernel": {"us": 4.0, "launches": 1.0}, "memset32": {"us": 1.0, "launches": 0.5},
    }  # fmt: skip
    kinds = step_profile.by_kind(rows)
    assert kinds["solver"] == {"us": 4.0, "launches": 1.0, "share": 0.8}
    assert sum(row["share"] for row in kinds.values()) == 1.0


def test_short_kernels_are_summed_up_whatever_they_do() -> None:
    rows = {f"solve_{n}": {"us": 1.0, "launches": 1.0} for n in range(step_profile.SHOWN + 3)}
    kinds = step_profile.by_kind(rows)
    assert (kinds["solver"]["us"], kinds[step_profile.OTHERS]["us"]) == (step_profile.SHOWN, 3.0)
