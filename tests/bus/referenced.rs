//! An axis that was homed by an earlier program: known where the drive shows it, and for as long as it keeps its power.

use servocrab::{DriveConfig, Failure, HomingMethod, HomingParameters, Network, SetPoint, drives};
use servocrab_sim::{Segment, personality};

use crate::rig::{Line, Rig};

fn started(line: &Line, description: drives::DriveDescription) -> Rig {
    let mut drive = DriveConfig::new(description);
    for axis in ["y", "z"] {
        drive = drive.axis(axis);
    }
    Rig::start(Network::builder().link(line.wire()).drive(0, drive)).unwrap()
}

/// Homes `z` where it stands; `y` stays as it is.
fn homes_z(rig: &mut Rig) {
    let z = rig.net().axis("z").unwrap();
    rig.until(async {
        z.enable().await.unwrap();
        let homing = z.homing().await.unwrap();
        let here = HomingParameters::new(HomingMethod::CURRENT_POSITION);
        homing.home(here).await.unwrap();
    });
    assert!(z.status().referenced);
}

fn referenced(rig: &Rig) -> [bool; 2] {
    ["y", "z"].map(|axis| rig.net().axis(axis).unwrap().status().referenced)
}

#[test]
fn the_next_program_knows_it_without_another_homing() {
    let line = Line::new(Segment::new().with(personality::akd2g()));
    let mut rig = started(&line, drives::akd2g());
    assert_eq!(referenced(&rig), [false; 2]);
    homes_z(&mut rig);
    rig.shutdown();
    let mut rig = started(&line, drives::akd2g());
    assert_eq!(referenced(&rig), [false, true], "of this axis, not of both");
    rig.moved("z", 5_000);
    let y = rig.net().axis("y").unwrap();
    let refused = rig.until(async {
        y.enable().await.unwrap();
        let mode = y.profile_position().await.unwrap();
        mode.move_abs(5_000, SetPoint::new()).await.unwrap_err()
    });
    assert_eq!(refused.failure(), Some(Failure::NotReferenced));
    rig.shutdown();
}

#[test]
fn a_drive_that_lost_its_power_shows_it_no_more() {
    let line = Line::new(Segment::new().with(personality::akd2g()));
    let mut rig = started(&line, drives::akd2g());
    homes_z(&mut rig);
    let ended = rig.bus.now();
    rig.shutdown();
    {
        let mut segment = line.segment();
        let device = segment.device_mut(0).unwrap();
        device.power_off();
        device.power_on(ended);
    }
    let rig = started(&line, drives::akd2g());
    assert_eq!(referenced(&rig), [false; 2]);
    rig.shutdown();
}

#[test]
fn a_drive_of_which_no_document_says_where_it_shows_it_is_homed_again() {
    let line = Line::new(Segment::new().with(personality::akd2g()));
    let mut description = drives::akd2g();
    description.traits.homed = None;
    let mut rig = started(&line, description.clone());
    homes_z(&mut rig);
    rig.shutdown();
    let rig = started(&line, description);
    assert_eq!(referenced(&rig), [false; 2]);
    rig.shutdown();
}
