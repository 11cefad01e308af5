//! The shortest cycle against the number of axes, by the formula of docs/scaling.md.

use plotters::prelude::RGBColor;

use crate::{
    Result,
    cable::Cable,
    chart::{self, Frame},
};

const MOST_AXES: usize = 256;
/// Bytes of an axis, outputs and inputs, axes of a drive, what that is, and its colour.
const CURVES: [(usize, usize, &str, RGBColor); 4] = [
    (
        60,
        1,
        "60 bytes an axis, one axis a drive",
        RGBColor(150, 30, 90),
    ),
    (
        30,
        1,
        "30 bytes (default mapping), one axis a drive",
        RGBColor(194, 84, 0),
    ),
    (
        30,
        2,
        "30 bytes (default mapping), two axes a drive",
        RGBColor(0, 92, 175),
    ),
    (
        14,
        2,
        "14 bytes (words, modes, positions), two axes a drive",
        RGBColor(60, 130, 60),
    ),
];

pub(crate) fn shortest_cycle() -> Result {
    let curves = CURVES.map(|(bytes, in_a_drive, name, color)| {
        let points = (1..=MOST_AXES / in_a_drive).map(|drives| {
            let cable = Cable {
                drives,
                bytes: bytes * in_a_drive,
                clock: true,
                metres: 2 * drives,
            };
            let cycle = cable.nanoseconds() as f64 / 1e3 * 4.0 / 3.0;
            ((drives * in_a_drive) as f64, cycle)
        });
        (name, color, points.collect())
    });
    let frame = Frame {
        file: "scaling.svg",
        height: 480,
        title: "Shortest cycle on 100 Mbit/s: 4/3 of the frames' time on the cable",
        x: ("axes", MOST_AXES as f64),
        y: ("cycle, µs", 0.0..2_200.0),
        names: (100, 10),
    };
    chart::draw(&frame, curves)
}
