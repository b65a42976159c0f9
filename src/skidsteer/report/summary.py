"""The first screen: the robot, one sentence, three numbers."""

from __future__ import annotations

from dataclasses import dataclass

from skidsteer.calibration import Calibration
from skidsteer.models import MatrixModel
from skidsteer.report.drift import Drift
from skidsteer.report.evidence import Evidence
from skidsteer.report.markup import Content, Html, rounded, spread, tag
from skidsteer.report.reckoner import known_vehicle
from skidsteer.report.robot import robot_drawing
from skidsteer.report.treads import SLOW, TreadIcrs, tread_icrs
from skidsteer.vehicle import Vehicle


@dataclass(frozen=True, slots=True)
class Number:
    """One of the three: what it is, before and after, and what it rests on."""

    title: str
    before: str
    after: str
    note: str


def summary(evidence: Evidence) -> Html:
    """Robot from above beside the sentence and the numbers."""
    calibration = evidence.calibration
    vehicle, icrs = known_vehicle(calibration.vehicle), tread_icrs(calibration)
    picture = tag("figure", robot_drawing(vehicle, icrs), tag("figcaption", _caption(calibration, vehicle, icrs)))
    numbers = [n for n in (_distance(evidence), _turn(evidence), _change(evidence)) if n is not None]
    cards = tag("dl", *(_card(n, before_name(evidence)) for n in numbers), class_="numbers")
    words = tag("div", tag("p", sentence(evidence), class_="sentence"), cards, _basis(evidence), class_="words")
    return tag("section", tag("h2", "In short", class_="hidden"), picture, words, class_="summary", id="summary")


def before_name(evidence: Evidence) -> str:
    """The model before calibration: as the robot ships, where that is known."""
    return "shipped" if "shipped" in evidence.models else "nominal"


def sentence(evidence: Evidence) -> str:
    """What this calibration changes, in one sentence."""
    before, drift, turn = before_name(evidence), evidence.drift, evidence.turn
    who = "the robot's dead reckoning as it ships" if before == "shipped" else "plain dead reckoning"
    if drift is not None or turn is not None:
        was = (
            [f"{_metres(drift, before)} off {'along' if drift.is_fitted else 'after'} {drift.whole:g} m"]
            if drift
            else []
        )
        was += [f"{_degrees(turn, before)} {'' if drift else 'off '}after a full turn"] if turn else []
        now = [_metres(drift, "calibrated")] if drift else []
        now += [_degrees(turn, "calibrated")] if turn else []
        return f"On ground like this, {who} is {' and '.join(was)}; with this calibration it is {' and '.join(now)}."
    nominal = evidence.calibration.vehicle.track_width
    turn = evidence.calibration.model.twist(-SLOW, SLOW)[2]
    width = float(2.0 * SLOW / turn)
    return (
        f"On the ground of this calibration the robot turns on the spot as if it were {rounded(width, 3)} m wide, not"
        f" {rounded(nominal, 3)} m: reckoned with its track width it seems to turn {rounded(width / nominal, 3)} times"
        " as far as it does."
    )


def _metres(drift: Drift, name: str) -> str:
    return rounded(drift.errors[name], 2, "m")


def _degrees(turn: Drift, name: str) -> str:
    return rounded(turn.errors[name], 2, "°")


def _distance(evidence: Evidence) -> Number | None:
    drift, before = evidence.drift, before_name(evidence)
    if drift is None:
        return None
    title = f"path error along {drift.whole:g} m" if drift.is_fitted else f"drift per {drift.whole:g} m"
    return Number(title, _metres(drift, before), _metres(drift, "calibrated"), _stretches(drift, "m"))


def _turn(evidence: Evidence) -> Number | None:
    turn, before = evidence.turn, before_name(evidence)
    if turn is None:
        return None
    return Number(
        "yaw error per full turn", _degrees(turn, before), _degrees(turn, "calibrated"), _stretches(turn, "°")
    )


def _stretches(drift: Drift, unit: str) -> str:
    length = rounded(drift.length, 3 if drift.length >= 100 else 2 if drift.length >= 10 else 1, unit)
    if drift.is_fitted:
        return (
            f"median RMS over {drift.stretches:.0f} stretches of {length}, each turned and moved to fit the reference"
        )
    scaled = "" if drift.length == drift.whole else ", scaled up"
    return f"median over stretches of {length}{scaled}; {drift.stretches:.0f} that do not overlap"


def _change(evidence: Evidence) -> Number | None:
    """The separation multiplier, on the separation of the block to paste; on what the robot ships with in the note."""
    if evidence.forced is None:
        return None
    own, known = evidence.calibration.vehicle, known_vehicle(evidence.calibration.vehicle)
    multipliers = evidence.forced.projection.multipliers
    separation = own.factory_separation or own.track_width
    sides = multipliers.left_wheel_radius_multiplier, multipliers.right_wheel_radius_multiplier
    before, note = "1", f"on a wheel_separation of {separation:g} m"
    if known.factory_separation is not None and known.factory_multiplier is not None:
        before = f"{known.factory_separation * known.factory_multiplier / separation:.4g}"
        if own.factory_separation is None:
            after = multipliers.separation / known.factory_separation
            note += f"; on the {known.factory_separation:g} m it ships with {known.factory_multiplier:g} → {after:.3f}"
    note += f"; radius multipliers {sides[0]:.3f} left, {sides[1]:.3f} right"
    return Number("wheel_separation_multiplier", before, f"{multipliers.separation / separation:.3f}", note)


def _card(number: Number, before: str) -> Html:
    change = (
        tag("span", number.before, class_=f"before {before}"),
        tag("span", " → ", class_="to", aria_hidden="true"),
        tag("span", " to ", class_="hidden"),
        tag("span", number.after, class_="after"),
    )
    return tag(
        "div", tag("dt", number.title), tag("dd", change, class_="change"), tag("dd", number.note, class_="note")
    )


def _basis(evidence: Evidence) -> Html:
    """What before and after mean."""
    vehicle, before = known_vehicle(evidence.calibration.vehicle), before_name(evidence)
    if before == "shipped":
        multiplier, separation = vehicle.factory_multiplier or 1.0, vehicle.factory_separation or 0.0
        source = "" if evidence.calibration.vehicle.factory_multiplier else f", by the preset of {vehicle.name}"
        was = f"Before: the multiplier the robot ships with, {multiplier:g} on {separation:g} m{source}."
    else:
        was = f"Before: a differential drive with the track width of {vehicle.track_width:g} m."
    return tag("p", was, " ", on_what(evidence), class_="basis")


def on_what(evidence: Evidence) -> str:
    """Whether the fit that predicts the drives has seen them."""
    if not evidence.drives:
        return "No drive is at hand: what needs one is left out."
    if not evidence.judged:
        return "The errors over a drive were not measured: what needs a drive with a reference is left out."
    if not evidence.is_seen:
        return "After: the calibration on drives that it was not made from."
    if evidence.is_held_out:
        return (
            "After: held out, each block of time predicted by a fit of the same model that has not seen it. The errors"
            " of the reference are in all of these figures."
        )
    return "After: on drives that the calibration was made from, so somewhat too good; see the held-out errors below."


def _caption(calibration: Calibration, vehicle: Vehicle, icrs: TreadIcrs) -> Content:
    rows: list[tuple[str, Content]] = [
        ("icr", _pair("left tread ICR", icrs, 0)),
        ("icr", _pair("right tread ICR", icrs, 1)),
        ("icr-x", _ahead(icrs)),
    ]
    slow = (
        "" if isinstance(calibration.model, MatrixModel) else " In a slow turn on the spot; they move with the speed."
    )
    guess = "" if vehicle.wheel_base else " The wheel base is not known: front and rear are drawn by guess, dashed."
    items = [tag("li", tag("span", class_=f"key {kind}", aria_hidden="true"), words) for kind, words in rows]
    note = f"To scale; ellipses hold the true ICR with 95 %.{slow}{guess} Body and width of the wheels are only drawn."
    return (tag("ul", *items, class_="keys"), tag("p", note))


def _pair(name: str, icrs: TreadIcrs, i: int) -> str:
    value, sigma = spread(float(icrs.place[i, 1]), float(icrs.covariance[i, 1, 1] ** 0.5))
    return f"{name}: y = {value} m" if sigma == "fixed" else f"{name}: y = {value} ± {sigma} m"


def _ahead(icrs: TreadIcrs) -> str:
    """Position of the axis of rotation."""
    left, right = icrs.place[:, 0].tolist()
    if abs(left - right) > 1e-3:  # a model in which the treads' ICRs are free
        return f"x = {rounded(left, 2)} m of the left one, {rounded(right, 2)} m of the right one"
    value, sigma = spread(abs(left), float(icrs.covariance[0, 0, 0] ** 0.5))
    if sigma == "fixed":
        return f"icr_x: {value} m, where the model takes the robot to turn about"
    return f"icr_x: {value} ± {sigma} m {'behind' if left < 0.0 else 'ahead of'} base_link, where the robot turns about"
