//! A press that is held at a torque: its position, and its torque.

use std::time::Duration;

use plotters::prelude::RGBColor;
use servocrab::{SetPoint, coe::obj, units::Mm};
use servocrab_sim::{Segment, personality::Servo};

use crate::{
    Result,
    chart::{self, Frame},
    line::{Line, axis, position},
};

/// What is shown, in ms.
const SHOWN: u16 = 700;
/// In thousandths of the rated torque.
const FORCE: u16 = 333;

pub(crate) fn contact() -> Result {
    let mut segment = Segment::new().with(Servo::generic().build());
    let part = segment.axis_mut(0, 0).ok_or("the drive has no axis")?;
    part.put_wall(50_000, 0.005);
    let mut line = Line::start(segment, vec![axis("ram")?.map_input(obj::TORQUE_ACTUAL)])?;
    let ram = line.net.axis_in::<Mm>("ram")?;
    line.until(ram.enable())?;
    let positions = line.until(ram.profile_position())?;
    let slowly = SetPoint::new()
        .velocity(20.0)
        .acceleration(200.0)
        .deceleration(2_000.0)
        .until_torque(FORCE, Duration::from_millis(10));
    let _motion = line.until(positions.move_abs(20.0, slowly))?;

    let (mut at, mut torque) = (Vec::new(), Vec::new());
    for ms in 0..SHOWN {
        let ms = f64::from(ms);
        line.millisecond(|segment| {
            let shown = segment.axis(0, 0).and_then(|axis| axis.get(0x6077, 0));
            at.push((ms, position(segment, 0)));
            torque.push((ms, shown.unwrap_or(0) as f64 / 10.0));
        });
    }
    let frame = Frame {
        file: "press.svg",
        height: 420,
        title: "A move until a third of the rated torque, and the axis that is held",
        x: ("time, ms", f64::from(SHOWN)),
        y: ("mm, % of the rated torque", -2.0..40.0),
        names: (100, 10),
    };
    let limit = f64::from(FORCE) / 10.0;
    chart::draw(
        &frame,
        [
            ("position, mm", RGBColor(0, 92, 175), at),
            ("torque (6077h), %", RGBColor(194, 84, 0), torque),
            (
                "the torque that ends the move",
                RGBColor(130, 135, 142),
                vec![(0.0, limit), (f64::from(SHOWN), limit)],
            ),
        ],
    )
}
