//! A touch probe in the process data of a network: mapped for the second axis of a drive, and over a loss of it.

use servocrab::{
    Failure, Network, SetPoint,
    axis::{AxisErrorKind, Edge, Probe, ProbeError},
    coe::obj,
};
use servocrab_sim::{
    Segment,
    ds402::{Behaviour, Mark},
    personality::Servo,
};

use crate::rig::{Line, Rig, akd2g};

fn started() -> (Line, Rig) {
    let mut behaviour = Behaviour::akd2g();
    behaviour.machine.probes = [None, Some(Mark::new(12_345, 14_000))];
    let line = Line::new(Segment::new().with(Servo::akd2g().axis_behaviour(1, behaviour).build()));
    let drive = akd2g().change_axis("y", |axis| {
        axis.map_output(obj::TOUCH_PROBE_FUNCTION)
            .map_input(obj::TOUCH_PROBE_STATUS)
            .map_input(obj::TOUCH_PROBE_2_NEGATIVE)
    });
    let rig = Rig::start(Network::builder().link(line.wire()).drive(0, drive)).unwrap();
    (line, rig)
}

#[test]
fn the_second_axis_of_a_drive_has_a_probe_of_its_own() {
    let (line, mut rig) = started();
    let axis = rig.net().axis("y").unwrap();
    rig.until(axis.enable()).unwrap();
    let position = rig.until(async {
        let pp = axis.profile_position().await.unwrap();
        let probe = axis.probe(Probe::Two).edge(Edge::Falling);
        let probe = probe.arm().await.unwrap();
        let moved = pp.move_abs(20_000, SetPoint::new().velocity(100_000));
        let moved = moved.await.unwrap();
        let position = probe.latched().await.unwrap();
        moved.done().await.unwrap();
        position
    });
    assert_eq!(position, 14_001);
    // The first axis has none in its process data, and none that meets anything: its objects are read all the same.
    let first = rig.net().axis("x").unwrap();
    let probe = rig.until(first.probe(Probe::One).arm()).unwrap();
    let function = |axis| line.segment().axis(0, axis).unwrap().get(0x60B8, 0);
    assert_eq!((function(0), function(1)), (Some(0x0011), Some(0)));
    rig.until(probe.disarm()).unwrap();
    assert_eq!(function(0), Some(0));
    rig.shutdown();
}

#[test]
fn a_probe_does_not_outlive_a_loss_of_its_drive() {
    let (line, mut rig) = started();
    let axis = rig.net().axis("y").unwrap();
    let arm = || axis.probe(Probe::Two).edge(Edge::Falling).arm();
    let probe = rig.until(arm()).unwrap();
    line.segment().device_mut(0).unwrap().power_off();
    let error = rig.until(probe.latched()).unwrap_err();
    assert!(
        matches!(error.failure(), Some(Failure::BusLost { .. })),
        "{error}"
    );
    let now = rig.bus.now();
    line.segment().device_mut(0).unwrap().power_on(now);
    rig.run_for(std::time::Duration::from_millis(100));
    rig.recover(0).unwrap();
    let error = rig.until(probe.latched()).unwrap_err();
    assert!(
        matches!(
            error.kind,
            AxisErrorKind::Probe(ProbeError::SwitchedOff { .. })
        ),
        "{error}"
    );
    drop(probe);
    let _again = rig.until(arm()).unwrap();
    let function = line.segment().axis(0, 1).unwrap().get(0x60B8, 0);
    assert_eq!(function, Some(0x2100));
    rig.shutdown();
}
