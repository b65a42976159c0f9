"""What Wang et al. 2015 measured on a robot, beside the same on a simulated one: Tables 3, 4 and Figs. 5, 12-14."""

from __future__ import annotations

import numpy as np

from skidsteer.identify.circle_test import fit_coefficient, wang_protocol
from skidsteer.models.curvature import icr_coefficient
from skidsteer.reproduce import wang2015
from skidsteer.reproduce.figure import Curve, Figure
from skidsteer.reproduce.rows import Reproduction, Row, stands_in
from skidsteer.reproduce.wang2015 import PRINTED, SCATTER_3, TABLE_3, TABLE_4, TRACK_WIDTH
from skidsteer.reproduce.wang_runs import EXAMPLE, ROBOT, VEHICLE, Reckonings, Runs, reckonings, runs, watch
from skidsteer.reproduce.wang_runs import FACTORY_CHI as PRINTED_CHI
from skidsteer.se2 import FloatArray
from skidsteer.terramechanics.steady_turn import rims_on_path, steady_turn
from skidsteer.terramechanics.terrain import TERRAINS, Terrain

RATIOS = np.arange(8.0)  # lambda of Table 3
SPEED = 0.3  # [m/s] of Figs. 5 and 13
FLOOR = "on the floor `tiles`, two numbers of which were fitted to this table"
RUN = (0.25, 0.475)  # [m/s], [m] of Fig. 11
TURNED = 1.6  # [rad] turned in it, for the plate to be seen
APART = 20  # scans over which a velocity is taken
AXES = ("x [m]", "y [m]", "heading [rad]")


def reproduction() -> Reproduction:
    """Everything, calculated and simulated."""
    found = runs()
    path = reckonings(found)
    every = (*wang2015.rows(), *rows(found, path))
    return Reproduction(every, figures(found, path), (), wang2015.PLACES, wang2015.NOTES)


def rows(found: Runs, path: Reckonings) -> tuple[Row, ...]:
    """The measured figures beside those of the simulated robot."""
    return (*_fall_rows(), _count_row(), *_table_3_rows(found), *_scatter_rows(found), *_path_rows(path))


def curve(terrain: Terrain) -> FloatArray:
    """Chi (8,) of steady turns at each lambda of Table 3."""
    rims = rims_on_path(RATIOS, SPEED)
    return steady_turn(ROBOT, terrain, rims[:, 0], rims[:, 1]).icr_coefficient


def _fall_rows() -> tuple[Row, ...]:
    chi = curve(TERRAINS["lab"])
    falls = float((np.diff(chi) < 0.0).sum())
    none = (
        "'chi decreases as lambda increases': Eqs. (16)-(22) with Table 1 give a fall from the spot to a circle, by"
        " rolling resistance, without which there is none; after it the centrifugal force makes chi rise"
    )
    beside = "beside Table 3, since Fig. 5 has no numbers"
    return (
        Row("steps of lambda from 0 to 7 in which chi falls, Fig. 5", 7.0, falls, "cannot be reproduced", none),
        stands_in("fall of chi from lambda 0 to 1, Fig. 5", TABLE_3[0] - TABLE_3[1], float(chi[0] - chi[1]), beside),
        stands_in("fall of chi from lambda 1 to 7, Fig. 5", TABLE_3[1] - TABLE_3[7], float(chi[1] - chi[7]), beside),
    )


def _count_row() -> Row:
    asked, driven = len(wang_protocol()), len(wang_protocol(VEHICLE.max_wheel_speed))
    why = f"lambda 1 at 0.4 and 0.5 m/s, 2 at 0.5 m/s ask more of a wheel than its {VEHICLE.max_wheel_speed:g} m/s"
    return Row("runs that the robot can drive, Eqs. (26), (27)", asked, driven, "cannot be reproduced", why)


def _table_3_rows(found: Runs) -> tuple[Row, ...]:
    fit, table = found.fit(), fit_coefficient(RATIOS, TABLE_3)
    chi = (
        stands_in(f"chi of the runs at lambda = {x:g}, Table 3", mean, float(found.of(x).mean()), FLOOR)
        for x, mean in zip(RATIOS.tolist(), TABLE_3, strict=True)
    )
    beside = "{} from Table 3 as printed; sigma {:.4f} of the runs', which scatter by {:.4f} about the curve"
    sigma = np.sqrt(np.diag(fit.covariance))
    return (
        *chi,
        stands_in(
            "a of Eq. (44) from the runs",
            PRINTED[0],
            fit.a,
            beside.format(f"{table.a:.3f}", sigma[0], fit.rms),
        ),
        stands_in(
            "b of Eq. (44) from the runs",
            PRINTED[1],
            fit.b,
            beside.format(f"{table.b:.3f}", sigma[1], fit.rms),
        ),
    )


def _scatter_rows(found: Runs) -> tuple[Row, ...]:
    each = [found.of(x) for x in RATIOS]
    sigma = max(float(chi.std(ddof=1)) for chi in each)
    relative = max(float(np.abs(chi / chi.mean() - 1.0).max()) for chi in each)
    error = found.chi - found.steady_chi
    speeds = (
        "the plant's own: chi falls with the speed by the centrifugal force, which Fig. 12 (b) does not show;"
        f" counts and scans err by {np.sqrt(np.mean(error**2)):.4f} RMS"
    )
    y0 = 0.5 * TRACK_WIDTH * float(np.abs(error).max())
    return (
        stands_in("largest standard deviation over the speeds, Table 3", max(SCATTER_3), sigma, speeds),
        stands_in("largest relative error of chi, Table 3", 0.0092, relative, speeds),
        _within("largest error of y0 [m], Eq. (43)", 0.007, y0, "against the plant's own; the paper's is a bound"),
    )


def _within(what: str, bound: float, ours: float, reason: str) -> Row:
    held = "within the printed bound" if ours <= bound else "beyond the printed bound"
    return stands_in(f"{what}, in the runs", bound, ours, f"{held}; {reason}")


def _path_rows(path: Reckonings) -> tuple[Row, ...]:
    swapped = {"P3-AT": TABLE_4["proposed"], "proposed": TABLE_4["P3-AT"]}
    known = ", ".join(f"{np.hypot(*path.errors(f'{name}, slide known')[:2]):.3f} m ({name})" for name in swapped)
    slid = (
        f"the plant slides {abs(path.slid):.3f} m sideways, which neither model knows and which makes up for a wrong"
        f" heading; with the slide known the position errs by {known}"
    )
    table = tuple(
        stands_in(f"path of Eq. (48), {model} model, {axis}, Table 4 with its rows swapped", printed, ours, slid)
        for model, paper in swapped.items()
        for axis, printed, ours in zip(AXES, paper, path.errors(model).tolist(), strict=True)
    )
    off = np.abs(path.off("proposed"))
    largest = float(np.hypot(off[:, 0], off[:, 1]).max())
    return (
        *table,
        _within("largest position error of the proposed model [m], section 3.5", 0.03, largest, slid),
        _within("largest angle error of the proposed model [rad], section 3.5", 0.1, float(off[:, 2].max()), slid),
    )


def figures(found: Runs, path: Reckonings) -> tuple[Figure, ...]:
    """Counterparts of Figs. 5 and 11 to 16."""
    return (
        _curve_figure(),
        *_one_run_figures(),
        *_run_figures(found),
        _fit_figure(found),
        _path_figure(path),
        *_error_figures(path),
        _chi_figure(),
    )


def _measured() -> Curve:
    chi, sigma = np.array(TABLE_3), np.array(SCATTER_3)
    return Curve("measured, Table 3", RATIOS, chi, chi - sigma, chi + sigma, measured=True)


def _one_run_figures() -> tuple[Figure, Figure]:
    """The run of Fig. 11: 0.25 m/s on a radius of 0.475 m, by the plate."""
    speed, radius = RUN
    rims = rims_on_path([radius / (0.5 * PRINTED_CHI * TRACK_WIDTH)], speed)
    seen = watch(rims, [TURNED * radius / speed], TERRAINS["tiles"], 11).poses
    t, (x, y, heading) = seen.t, seen.values.T
    apart = APART
    dt = t[apart:] - t[:-apart]
    speeds = np.hypot(x[apart:] - x[:-apart], y[apart:] - y[:-apart]) / dt
    place = (Curve("x [m]", t, x), Curve("y [m]", t, y), Curve("heading [rad]", t, np.unwrap(heading)))
    rates = (Curve("speed [m/s]", t[:-apart], speeds), Curve("yaw rate [rad/s]", t[:-apart], _rate(heading, dt, apart)))
    words = f"{speed:g} m/s on a radius of {radius:g} m, simulated"
    return (
        Figure("figure-11a", f"Position and heading, {words}", "time [s]", "x, y [m], heading [rad]", place),
        Figure("figure-11b", f"Velocity, {words}", "time [s]", "speed [m/s], yaw rate [rad/s]", rates),
    )


def _rate(heading: FloatArray, dt: FloatArray, apart: int) -> FloatArray:
    whole = np.unwrap(heading)
    return np.asarray((whole[apart:] - whole[:-apart]) / dt)


def _curve_figure() -> Figure:
    curves = [Curve(f"steady turns, {name}", RATIOS, curve(TERRAINS[name])) for name in ("lab", "tiles")]
    return Figure("figure-5", f"ICR coefficient at {SPEED:g} m/s", "lambda [-]", "chi [-]", (*curves, _measured()))


def _run_figures(found: Runs) -> tuple[Figure, Figure]:
    x, v = found.path_curvature, found.speed
    by_speed = [Curve(f"{s:.1f} m/s", x[v == s], found.chi[v == s]) for s in np.unique(v)]
    by_ratio = [Curve(f"lambda {r:g}", v[x == r], found.chi[x == r]) for r in np.unique(x)]
    return (
        Figure("figure-12a", "Runs of the simulated robot", "lambda [-]", "chi [-]", tuple(by_speed)),
        Figure("figure-12b", "Runs of the simulated robot", "speed [m/s]", "chi [-]", tuple(by_ratio)),
    )


def _fit_figure(found: Runs) -> Figure:
    fit, x = found.fit(), np.linspace(0.0, 10.0, 101)
    mine = np.isclose(found.speed, SPEED)
    curves = (
        Curve(f"runs at {SPEED:g} m/s", found.path_curvature[mine], found.chi[mine]),
        Curve("steady turns of the plant", found.path_curvature[mine], found.steady_chi[mine]),
        Curve("Eq. (44) fitted to the runs", x, icr_coefficient(x, fit.a, fit.b)),
        Curve("Eq. (45) as printed", x, icr_coefficient(x, *PRINTED)),
        _measured(),
    )
    return Figure("figure-13", "Curve through the runs", "lambda [-]", "chi [-]", curves)


def _path_figure(path: Reckonings) -> Figure:
    lines = {"seen by the scanner": path.seen, **{f"{name} model": line for name, line in path.by_model.items()}}
    curves = tuple(
        Curve(label, line[:, 0], line[:, 1], measured=label.startswith("seen")) for label, line in lines.items()
    )
    return Figure("figure-14", "Path of Eq. (48) in the scanner's frame", "x [m]", "y [m]", curves, to_scale=True)


def _error_figures(path: Reckonings) -> tuple[Figure, Figure]:
    off = {name: path.off(name) for name in ("P3-AT", "proposed")}
    place = tuple(Curve(f"{name} model", path.t, np.hypot(e[:, 0], e[:, 1])) for name, e in off.items())
    angle = tuple(Curve(f"{name} model", path.t, e[:, 2]) for name, e in off.items())
    return (
        Figure("figure-15a", "Errors of position on the path of Eq. (48)", "time [s]", "error [m]", place),
        Figure("figure-15b", "Errors of heading on the path of Eq. (48)", "time [s]", "error [rad]", angle),
    )


def _chi_figure() -> Figure:
    """Chi of each second of Eq. (48) by Eq. (45) as printed, and the constant of Eq. (46)."""
    left, right = EXAMPLE.T
    chi = icr_coefficient((left + right) / (right - left), *PRINTED)
    t = np.repeat(np.arange(len(EXAMPLE) + 1.0), 2)[1:-1]
    curves = (
        Curve("proposed model", t, np.repeat(chi, 2)),
        Curve("P3-AT model", t, np.full(len(t), PRINTED_CHI)),
    )
    return Figure("figure-16", "ICR coefficient on the path of Eq. (48)", "time [s]", "chi [-]", curves)
