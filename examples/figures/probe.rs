//! A part that is measured beside a move: the position, and where the drive has latched the edges.

use std::pin::pin;

use plotters::prelude::RGBColor;
use servocrab::{
    SetPoint,
    axis::{Edge, Probe},
    coe::obj,
    units::Mm,
};
use servocrab_sim::{Segment, ds402::Mark, personality::Servo};

use crate::{
    Result,
    chart::{self, Frame},
    line::{Line, axis, position},
};

/// What is shown, in ms.
const SHOWN: f64 = 1_000.0;
const SPEED: f64 = 100.0;

pub(crate) fn edges() -> Result {
    let part = Mark::new(200_000, 623_449);
    let servo = Servo::generic().change(move |drive| drive.machine.probes[0] = Some(part));
    let feed = axis("feed")?
        .map_output(obj::TOUCH_PROBE_FUNCTION)
        .map_input(obj::TOUCH_PROBE_STATUS)
        .map_input(obj::TOUCH_PROBE_1_POSITIVE)
        .map_input(obj::TOUCH_PROBE_1_NEGATIVE);
    let mut line = Line::start(Segment::new().with(servo.build()), vec![feed])?;
    let feed = line.net.axis_in::<Mm>("feed")?;
    line.until(feed.enable())?;
    let positions = line.until(feed.profile_position())?;
    let begin = line.now_ms();
    let motion = SetPoint::new().velocity(SPEED).acceleration(1_000.0);
    let _motion = line.until(positions.move_abs(80.0, motion))?;
    let mut at = Vec::new();
    let mut latched = Vec::new();
    for edge in [Edge::Rising, Edge::Falling] {
        let probe = line.until(feed.probe(Probe::One).edge(edge).arm())?;
        let mut edge = pin!(probe.latched());
        loop {
            at.push((line.now_ms() - begin, line.millisecond(seen)));
            if let Some(edge) = smol::block_on(smol::future::poll_once(&mut edge)) {
                // A mark across the picture where it was, from where it is known.
                latched.push((line.now_ms() - begin, edge?));
                break;
            }
        }
    }
    while line.now_ms() - begin < SHOWN {
        at.push((line.now_ms() - begin, line.millisecond(seen)));
    }
    let [(front_ms, front), (back_ms, back)] = latched[..] else {
        return Err("there are two edges".into());
    };
    let frame = Frame {
        file: "probe.svg",
        height: 420,
        title: "A part from 20.000 to 62.345 mm, measured beside a move",
        x: ("time, ms", SHOWN),
        y: ("mm", -5.0..90.0),
        names: (100, 10),
    };
    chart::draw(
        &frame,
        [
            ("position, mm", RGBColor(0, 92, 175), at),
            (
                "the part begins (60BAh), from when that is known",
                RGBColor(194, 84, 0),
                vec![(front_ms, front), (SHOWN, front)],
            ),
            (
                "it ends (60BBh)",
                RGBColor(150, 30, 90),
                vec![(back_ms, back), (SHOWN, back)],
            ),
        ],
    )
}

fn seen(segment: &mut Segment) -> f64 {
    position(segment, 0)
}
