//! A tool that joins, turns, is pulled and joins again: where its spindle is, and the axis that moves beside it.

use std::pin::pin;

use plotters::prelude::RGBColor;
use servocrab::{
    Axis, SetPoint,
    bus::{DevicePlace, Expected, HotConnect, NetworkEvent},
    units::Mm,
};
use servocrab_sim::{
    Segment,
    personality::{self, Servo},
};

use crate::{
    Result,
    chart::{self, Frame, Moments},
    line::{Line, axis, drive, position},
};

const ALIAS: u16 = 7;
/// Where the tool and the lasting drive stand: a frame goes through the coupler's port 3 first.
const TOOL: usize = 1;
const LASTING: usize = 2;
/// When the tool is plugged in, pulled and plugged in again, and what is shown, in ms.
const PLUGGED: u16 = 200;
const PULLED: u16 = 1_500;
const AGAIN: u16 = 1_800;
const SHOWN: u16 = 3_000;
/// How far both move, in mm; what is a millimetre of a spindle here is a turn.
const TRAVEL: f64 = 20.0;
const HOLE: f64 = 5.0;

pub(crate) fn comes_and_goes() -> Result {
    let mut segment = Segment::new()
        .with(personality::coupler())
        .with(personality::generic());
    if segment.attach(0, 3, Servo::generic().alias(ALIAS).build()) != Some(TOOL) {
        return Err("the coupler has no free port".into());
    }
    segment.unplug(TOOL);
    let (x, spindle) = (drive(axis("x")?), drive(axis("spindle")?));
    let mut line = Line::declared(segment, |builder| {
        let tool = DevicePlace::Alias(ALIAS);
        builder
            .expect(0, Expected::any())
            .drive(1, x)
            .optional("drill", |group| group.drive(tool, spindle))
    })?;
    let x = line.net.axis_in::<Mm>("x")?;
    let spindle = line.net.axis_in::<Mm>("spindle")?;
    let drill = line.net.hot_connect("drill")?;
    let mut work = pin!(smol::future::or(to_and_fro(&x), bore(&drill, &spindle)));
    let mut lasting = Vec::new();
    // Of each time that the tool was in.
    let mut turned: Vec<Vec<(f64, f64)>> = Vec::new();
    let mut named = Vec::new();
    for ms in 0..SHOWN {
        let at = f64::from(ms);
        match ms {
            PLUGGED | AGAIN => {
                named.push((at, "plugged in"));
                turned.push(Vec::new());
            }
            PULLED => named.push((at, "pulled")),
            _ => {}
        }
        let is_in = (PLUGGED..PULLED).contains(&ms) || ms >= AGAIN;
        let (x, spindle) = line.millisecond(|segment| {
            if is_in {
                segment.plug_in(TOOL);
            } else {
                segment.unplug(TOOL);
            }
            (position(segment, LASTING), position(segment, TOOL))
        });
        lasting.push((at, x));
        if let Some(turned) = turned.last_mut().filter(|_| is_in) {
            turned.push((at, spindle));
        }
        if let Some(ended) = smol::block_on(smol::future::poll_once(&mut work)) {
            ended?;
        }
        while let Some(event) = line.net.events().try_next() {
            match event {
                NetworkEvent::Joined { .. } => named.push((at, "Joined")),
                NetworkEvent::Left { .. } => named.push((at, "Left")),
                _ => {}
            }
        }
    }
    let counted = line.net.drive_statistics();
    let misses = counted.first().map(|drive| drive.stale_cycles);
    if misses != Some(0) {
        return Err("x has missed a cycle: the title is wrong".into());
    }
    let frame = Frame {
        file: "tool_changer.svg",
        height: 420,
        title: "A tool joins, turns, is pulled and joins again: the axis beside it misses no cycle",
        x: ("time, ms", f64::from(SHOWN)),
        y: ("mm, turns", -2.0..36.0),
        names: (100, 13),
    };
    let moments = Moments {
        height: 29.2,
        named,
    };
    let of_spindle = ["spindle of the tool while it is in, turns", ""];
    let of_spindle = of_spindle
        .into_iter()
        .zip(turned)
        .map(|(name, points)| (name, RGBColor(194, 84, 0), points));
    let of_x = (
        "x, which is there all the time, mm",
        RGBColor(0, 92, 175),
        lasting,
    );
    chart::draw_with(&frame, &moments, std::iter::once(of_x).chain(of_spindle))
}

async fn to_and_fro(x: &Axis<Mm>) -> Result {
    x.enable().await?;
    let mode = x.profile_position().await?;
    loop {
        for target in [TRAVEL, 0.0] {
            mode.move_abs(target, speed(100.0)).await?.done().await?;
        }
    }
}

async fn bore(drill: &HotConnect, spindle: &Axis<Mm>) -> Result {
    loop {
        drill.joined().await?;
        spindle.enable().await?;
        let mode = spindle.profile_position().await?;
        mode.move_rel(HOLE, speed(20.0)).await?.done().await?;
        spindle.disable().await?;
        drill.left().await?;
    }
}

fn speed(velocity: f64) -> SetPoint<Mm> {
    SetPoint::new()
        .velocity(velocity)
        .acceleration(10.0 * velocity)
        .deceleration(10.0 * velocity)
}
