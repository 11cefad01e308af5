//! A gantry whose second side jams in the middle of a move: where both sides are, and the skew.

use plotters::prelude::RGBColor;
use servocrab::{SetPoint, units::Mm};
use servocrab_sim::{Segment, personality::Servo};

use crate::{
    Result,
    chart::{self, Frame},
    line::{Line, axis, position},
};

/// The limits of the skew, in mm.
const WARN: f64 = 0.2;
const STOP: f64 = 1.0;
/// Where the second side jams, in mm, and what is shown before and after that, in ms.
const JAMS_AT: f64 = 30.0;
const BEFORE: usize = 20;
const AFTER: usize = 100;

pub(crate) fn one_side_jams() -> Result {
    let side = || Servo::generic().build();
    let segment = Segment::new().with(side()).with(side());
    let mut line = Line::start(segment, vec![axis("x1")?, axis("x2")?])?;
    let gantry = line.net.pair_in::<Mm>("x1", "x2")?.skew(WARN, STOP)?;
    line.until(gantry.enable())?;
    let fast = SetPoint::new()
        .velocity(100.0)
        .acceleration(500.0)
        .deceleration(500.0);
    let _motion = line.until(gantry.move_abs(2.0 * JAMS_AT, fast))?;

    let mut rows: Vec<[f64; 2]> = Vec::new();
    let mut jammed_at = None;
    while jammed_at.is_none_or(|at| rows.len() < at + AFTER) {
        let row = line.millisecond(|segment| {
            let row = [0, 1].map(|place| position(segment, place));
            if row[1] >= JAMS_AT
                && let Some(axis) = segment.axis_mut(1, 0)
            {
                axis.disturbances().blocked = true;
            }
            row
        });
        if row[1] >= JAMS_AT {
            jammed_at.get_or_insert(rows.len());
        }
        rows.push(row);
    }
    let begin = jammed_at.unwrap_or_default().saturating_sub(BEFORE);
    let curve = |of: fn(&[f64; 2]) -> f64| {
        let shown = (0..).zip(rows.iter().skip(begin));
        shown.map(|(ms, row)| (f64::from(ms), of(row))).collect()
    };
    let shown = (BEFORE + AFTER) as f64;
    let frame = Frame {
        file: "gantry.svg",
        height: 420,
        title: "A gantry at 100 mm/s whose second side jams after 20 ms: both are stopped",
        x: ("time, ms", shown),
        y: ("mm", -2.0..5.0),
        names: (100, 10),
    };
    chart::draw(
        &frame,
        [
            (
                "first side, from where the second one jams",
                RGBColor(0, 92, 175),
                curve(|row| row[0] - JAMS_AT),
            ),
            (
                "second side, likewise",
                RGBColor(194, 84, 0),
                curve(|row| row[1] - JAMS_AT),
            ),
            ("skew", RGBColor(150, 30, 90), curve(|row| row[0] - row[1])),
            (
                "stop of both, at 1 mm",
                RGBColor(130, 135, 142),
                vec![(0.0, STOP), (shown, STOP)],
            ),
        ],
    )
}
