//! "Related objects".

use servocrab::SetPoint;
use servocrab::axis::Completion;
use servocrab::coe::{AnyObject, ObjectAddress, obj};
use servocrab::pdo_map::Direction;
use servocrab_sim::ds402::{Access, Behaviour, DataType};

use super::drive;
use crate::bench::{Drive, assert_near};
use crate::common::Rig;

use Access::{ReadOnly, ReadWrite};
use DataType::{I16, I32, U16, U32};

/// The document's table: index, type, access, mandatory.
const TABLE: [(u16, DataType, Access, bool); 17] = [
    (0x6040, U16, ReadWrite, true),
    (0x6041, U16, ReadOnly, true),
    (0x6062, I32, ReadOnly, false),
    (0x6063, I32, ReadOnly, false),
    (0x6064, I32, ReadOnly, true),
    (0x6065, U32, ReadWrite, false),
    (0x6066, U16, ReadWrite, false),
    (0x6067, U32, ReadWrite, false),
    (0x6068, U16, ReadWrite, false),
    (0x607A, I32, ReadWrite, true),
    (0x6081, U32, ReadWrite, true),
    (0x6083, U32, ReadWrite, true),
    (0x6084, U32, ReadWrite, false),
    (0x6085, U32, ReadWrite, false),
    (0x6086, I16, ReadWrite, true),
    (0x60F4, I32, ReadOnly, false),
    (0x2010, U16, ReadWrite, true),
];

#[test]
pub(super) fn drive_has_the_objects_with_their_types() {
    let drive = Drive::new(Behaviour::pp2010());
    for (index, kind, access, _) in TABLE {
        let (is, may, _) = drive.attributes(index, 0);
        assert_eq!((is, may), (kind, access), "{index:04X}h");
    }
}

#[test]
pub(super) fn library_has_the_objects_with_their_types() {
    for (index, kind, ..) in TABLE {
        let objects: Vec<AnyObject> = obj::all();
        let known = objects
            .iter()
            .find(|object| object.address() == ObjectAddress::new(index, 0))
            .unwrap_or_else(|| panic!("{index:04X}h"));
        assert_eq!(usize::from(known.bits()), 8 * kind.size(), "{index:04X}h");
    }
}

#[test]
pub(super) fn drive_has_the_mandatory_objects() {
    let drive = Drive::new(Behaviour::pp2010());
    for (index, ..) in TABLE.iter().filter(|(.., mandatory)| *mandatory) {
        assert!(drive.entry(*index, 0).is_some(), "{index:04X}h");
        assert!(drive.axis.get(*index, 0).is_some(), "{index:04X}h");
    }
}

#[test]
pub(super) fn library_needs_no_more_than_the_objects_of_the_table() {
    let layout = servocrab::drives::pp2010()
        .default_mapping()
        .expect("a mapping")
        .layout();
    let drive = Drive::new(Behaviour::pp2010());
    for direction in [Direction::Outputs, Direction::Inputs] {
        for (object, place) in layout.objects(direction) {
            let entry = drive.entry(object.index, object.subindex);
            let entry = entry.unwrap_or_else(|| panic!("{object}: the drive does not have it"));
            assert_eq!(usize::from(place.bits), 8 * entry.kind.size());
        }
    }
    // 6084h is optional: without it in the process data a drive that does not have it is enabled and moved.
    let mut description = servocrab::drives::pp2010();
    let outputs = &mut description.axes[0].outputs;
    outputs.retain(|object| *object != obj::PROFILE_DECELERATION.into());
    let behaviour = Behaviour {
        without: &[0x6084, 0x606C],
        ..Behaviour::pp2010()
    };
    let mut rig = Rig::of(description, behaviour, |config| {
        config.defaults.deceleration = None;
    })
    .ideal();
    assert_eq!(rig.drive.get(0x6084, 0), None);
    rig.enable();
    let id = rig.abs(10_000, SetPoint::new());
    assert_eq!(rig.finish(id), Ok(Completion::Reached { position: 10_000 }));
    assert_eq!(rig.ledger().len(), 1);
}

#[test]
pub(super) fn drive_starts_and_stops_at_the_speed_of_2010h() {
    let mut drive = drive();
    drive.set(0x2010, 2_000);
    drive.start(0x2F, 10_000);
    drive.run(1);
    assert_near(drive.axis.velocity(), 2_000.0);
    let mut slowest = f64::INFINITY;
    while drive.axis.velocity() > 0.0 {
        slowest = slowest.min(drive.axis.velocity());
        drive.run(1);
    }
    assert_near(slowest, 2_000.0);
    assert_eq!(drive.axis.position(), 10_000);
}

#[test]
pub(super) fn library_knows_2010h() {
    let object = AnyObject::from(obj::MIN_PROFILE_VELOCITY);
    assert_eq!(object.address(), ObjectAddress::new(0x2010, 0));
    assert_eq!(object.bits(), 16);
}
