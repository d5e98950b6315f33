"""What the page on speed begins with: the quickest model, step by step and at equal error, and the peers."""

from __future__ import annotations

from collections.abc import Sequence

from clothbench.display.answer import Card, answer
from clothbench.display.html import group, text
from clothbench.studies.speed.bench import ASIDE, NO_PEERS, Row, of_peer, of_rest
from clothbench.studies.speed.timing import TOLERABLE


def answer_of(rows: Sequence[Row]) -> str:
    """The answer over all measurements, as HTML; "" where there are none."""
    mine = [r for r in rows if not of_peer(r) and r["peer"] not in ASIDE]
    plain, equal = ([r for r in mine if (r["error_m"] is not None) == at_equal] for at_equal in (False, True))
    if not plain:
        return ""
    moving = [
        r for r in plain if not of_rest(r)
    ] or plain  # iterations until rest and steps of time are not worth the same
    fastest = max(largest(moving), key=lambda r: r["node_steps_per_s"])
    lead = f"The quickest steps are <b>{text(fastest['model'])}</b>'s: {pace(fastest)} on {fastest['nodes']} nodes."
    if equal:
        best = max(largest(equal), key=lambda r: r["realtime_factor"])
        limit, times = f"{1e3 * TOLERABLE:g} mm at most", f"{best['realtime_factor']:.3g} times real time"
        lead += (
            f" Steps are not worth the same: where each model is off its own converged motion by {limit}, "
            f"<b>{text(best['model'])}</b> is the quickest, {times} on {best['nodes']} nodes."
        )
    return answer("Speed: the answer", lead, [*map(kind_card, kinds(plain)), *peer_cards(rows)])


def largest(rows: Sequence[Row]) -> list[Row]:
    """Those on the largest sheet."""
    return [r for r in rows if r["nodes"] == max(each["nodes"] for each in rows)]


def pace(row: Row) -> str:
    return f"{millions(row)} million node-{'iterations' if of_rest(row) else 'steps'}/s"


def millions(row: Row) -> str:
    """Node-steps/s in millions; what settles a sheet does thousands."""
    rate = row["node_steps_per_s"] / 1e6
    return f"{rate:.1f}" if rate >= 0.1 else f"{rate:.2g}"


def kinds(rows: Sequence[Row]) -> list[Row]:
    """The quickest of each kind of step."""
    some = group(largest(rows), lambda r: r["kind"] or "other")
    return [max(mine, key=lambda r: r["node_steps_per_s"]) for _, mine in sorted(some.items())]


def kind_card(row: Row) -> Card:
    detail = f"{row['model']}, {row['nodes']} nodes, {row['batch']} at once, {row['threads']} threads"
    return Card(f"Quickest {row['kind'] or 'other'} steps", pace(row), detail)


def peer_cards(rows: Sequence[Row]) -> list[Card]:
    """How many times as quick as each peer the models are, per core: step by step, and at equal error."""
    out = []
    known = [r for r in rows if r["ratio"] is not None and r["peer"] not in NO_PEERS]
    told = group(known, lambda r: f"{r['peer']}, at equal error" if r["error_m"] is not None else r["peer"])
    for peer, mine in sorted(told.items()):
        low, high = (end(r["ratio"] for r in mine) for end in (min, max))
        said = f"{low:.2g} × … {high:.2g} ×" if len(mine) > 1 else f"{low:.2g} ×"
        out.append(
            Card(
                f"Beside {peer}", said, f"per core, over {len(mine)} measurement{'s' * (len(mine) > 1)}", good=low >= 1
            )
        )
    return out
