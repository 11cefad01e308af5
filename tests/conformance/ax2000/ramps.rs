//! "Object 6086h: motion_profile_type".

use servocrab::coe::obj;
use servocrab::pdo_map::Mapping as PdoMapping;
use servocrab::{BufferMode, SetPoint};
use servocrab::{Failure, axis::Unsupported};
use servocrab_sim::ds402::{Access, Axis, DataType, Mapping, SetError};
use servocrab_sim::personality;

use super::{drive, rig};
use crate::bench::{VELOCITY, assert_near};
use crate::wire::Wire;

const OUT_OF_RANGE: u32 = 0x0609_0030;

fn after() -> SetPoint {
    SetPoint::new().buffer_mode(BufferMode::Buffered)
}

#[test]
pub(super) fn drive_chooses_the_ramp_by_6086h() {
    // After a quarter of the ramp's time: a quarter of the speed, or sin²(22.5°) of it; after half of it: half.
    for (kind, part) in [(0, 0.25), (1, 0.146)] {
        let mut drive = drive();
        drive.set(0x6086, kind);
        drive.start(0x0F, 20_000);
        let mut speeds = Vec::new();
        while drive.axis.velocity() < VELOCITY as f64 {
            speeds.push(drive.axis.velocity());
            drive.run(1);
        }
        assert!(speeds.len() < 200, "{} ms", speeds.len());
        let full = VELOCITY as f64;
        assert_near(speeds[speeds.len() / 4], full * part);
        assert_near(speeds[speeds.len() / 2], full * 0.5);
    }
}

#[test]
pub(super) fn library_chooses_the_ramp_with_the_set_point() {
    let mut rig = rig();
    for (kind, target) in [(1, 10_000), (0, 20_000), (1, 30_000)] {
        let id = rig.abs(target, after().profile_type(kind));
        assert!(rig.finish(id).is_ok());
        assert_eq!(rig.ledger().last().expect("a line").profile_type, kind);
    }
}

#[test]
pub(super) fn drive_has_6086h_as_16_bits_that_can_be_mapped() {
    let (kind, access, mapping) = drive().attributes(0x6086, 0);
    assert_eq!((kind, access), (DataType::I16, Access::ReadWrite));
    assert!(matches!(mapping, Mapping::Rx | Mapping::Both));
    let mut wire = Wire::new(personality::ax2000());
    assert_eq!(
        wire.map(0x1C12, 0x1600, &[0x6040_0010, 0x6086_0010]),
        Ok(())
    );
}

#[test]
pub(super) fn library_has_6086h_as_16_bits_that_can_be_mapped() {
    let layout = PdoMapping::builder()
        .rx_pdo(0x1600)
        .output(obj::MOTION_PROFILE_TYPE)
        .build()
        .expect("a mapping")
        .layout();
    assert_eq!(layout.output_bytes(), 2);
}

#[test]
pub(super) fn drive_takes_0_and_1() {
    let mut wire = Wire::new(personality::ax2000());
    for kind in [1_i16, 0] {
        assert_eq!(wire.download(0x6086, 0, &kind.to_le_bytes()), Ok(()));
        assert_eq!(wire.upload(0x6086, 0), Ok(kind.to_le_bytes().to_vec()));
    }
}

#[test]
pub(super) fn library_takes_0_and_1() {
    let mut rig = rig();
    for (kind, target) in [(0, 5_000), (1, 10_000)] {
        let id = rig.abs(target, after().profile_type(kind));
        assert!(rig.finish(id).is_ok(), "{kind}");
    }
}

#[test]
pub(super) fn drive_refuses_manufacturer_specific_types() {
    let mut wire = Wire::new(personality::ax2000());
    for kind in [-1_i16, -2, i16::MIN] {
        assert_eq!(
            wire.download(0x6086, 0, &kind.to_le_bytes()),
            Err(OUT_OF_RANGE),
            "{kind}"
        );
    }
    assert_eq!(wire.upload(0x6086, 0), Ok(vec![0, 0]));
}

/// That a move with this type is refused, and nothing is sent.
fn is_refused_by_the_library(kinds: &[i16]) {
    let mut rig = rig();
    for kind in kinds {
        let refused = rig.abs(5_000, after().profile_type(*kind));
        assert!(
            matches!(
                rig.outcome(refused),
                Some(Err(Failure::Unsupported(Unsupported::ProfileType { profile_type, .. })))
                    if profile_type == *kind
            ),
            "{kind}: {:?}",
            rig.outcome(refused)
        );
    }
    rig.run(50);
    assert!(rig.words.iter().all(|word| word & 0x10 == 0));
}

#[test]
pub(super) fn library_refuses_manufacturer_specific_types() {
    is_refused_by_the_library(&[-1, i16::MIN]);
}

#[test]
pub(super) fn drive_refuses_further_types() {
    let mut drive = drive();
    for kind in [2, 3, 32_767] {
        assert_eq!(drive.axis.set(0x6086, 0, kind), Err(SetError::OutOfRange));
    }
    assert_eq!(drive.get(0x6086), 0);
}

#[test]
pub(super) fn library_refuses_further_types() {
    is_refused_by_the_library(&[2, 3, i16::MAX]);
}

#[test]
pub(super) fn drive_keeps_6086h_in_its_eeprom() {
    let mut drive = drive();
    drive.set(0x6086, 1);
    drive.set(0x6081, 777);
    assert_eq!(drive.axis.restarted().get(0x6086, 0), Some(0), "not saved");
    drive.axis.save();
    let again: Axis = drive.axis.restarted();
    assert_eq!(again.get(0x6086, 0), Some(1));
    assert_ne!(again.get(0x6081, 0), Some(777), "this is not kept");
}
