//! The tables: data type, access, PDO mapping, value range, default, EEPROM.

use servocrab::coe::{AnyObject, ObjectAddress, obj};
use servocrab_sim::ds402::{Access, Behaviour, DataType, Mapping};
use servocrab_sim::personality;

use crate::bench::Drive;
use crate::wire::Wire;

/// "Cannot be mapped".
const NOT_MAPPABLE: u32 = 0x0604_0041;
const READ_ONLY: u32 = 0x0601_0002;

fn drive() -> Drive {
    Drive::powered_up(Behaviour::sigma7())
}

fn wire() -> Wire {
    Wire::new(personality::sigma7())
}

/// Widths of the library's objects.
fn assert_bits(objects: &[(AnyObject, ObjectAddress, u8)]) {
    for (object, address, bits) in objects {
        assert_eq!((object.address(), object.bits()), (*address, *bits));
    }
}

#[test]
pub(super) fn drive_has_607ah_as_the_table_says() {
    let mut drive = drive();
    let (kind, access, mapping) = drive.attributes(0x607A, 0);
    assert_eq!((kind, access), (DataType::I32, Access::ReadWrite));
    assert!(matches!(mapping, Mapping::Rx | Mapping::Both));
    assert_eq!(drive.get(0x607A), 0, "default");
    for value in [i64::from(i32::MIN), i64::from(i32::MAX), 5] {
        drive.set(0x607A, value);
        assert_eq!(drive.get(0x607A), value);
    }
    drive.axis.save();
    assert_eq!(drive.axis.restarted().get(0x607A, 0), Some(0), "not kept");
    assert_eq!(wire().map(0x1C12, 0x1600, &[0x607A_0020]), Ok(()));
}

#[test]
pub(super) fn library_has_607ah_as_the_table_says() {
    assert_bits(&[(
        obj::TARGET_POSITION.into(),
        ObjectAddress::new(0x607A, 0),
        32,
    )]);
}

#[test]
pub(super) fn drive_counts_two_limits() {
    let mut wire = wire();
    assert_eq!(wire.upload(0x607D, 0), Ok(vec![2]));
    assert_eq!(wire.download(0x607D, 0, &[3]), Err(READ_ONLY));
    assert_eq!(wire.map(0x1C12, 0x1600, &[0x607D_0008]), Err(NOT_MAPPABLE));
    let (kind, access, _) = drive().attributes(0x607D, 0);
    assert_eq!((kind, access), (DataType::U8, Access::ReadOnly));
}

#[test]
pub(super) fn drive_has_both_limits_as_the_table_says() {
    let mut wire = wire();
    for subindex in [1, 2] {
        let (kind, access, mapping) = drive().attributes(0x607D, subindex);
        assert_eq!(
            (kind, access, mapping),
            (DataType::I32, Access::ReadWrite, Mapping::None)
        );
        assert_eq!(wire.upload(0x607D, subindex), Ok(vec![0; 4]), "default");
        for value in [-536_870_912_i32, 536_870_911, 0] {
            let bytes = value.to_le_bytes();
            assert_eq!(wire.download(0x607D, subindex, &bytes), Ok(()));
            assert_eq!(wire.upload(0x607D, subindex), Ok(bytes.to_vec()));
        }
        for value in [-536_870_913_i32, 536_870_912, i32::MIN, i32::MAX] {
            let refused = wire.download(0x607D, subindex, &value.to_le_bytes());
            assert!(refused.is_err(), "{value}");
        }
        let entry = 0x607D_0020 | u32::from(subindex) << 8;
        assert_eq!(wire.map(0x1C12, 0x1600, &[entry]), Err(NOT_MAPPABLE));
    }
}

#[test]
pub(super) fn library_has_both_limits_as_the_table_says() {
    assert_bits(&[
        (
            obj::SOFTWARE_LIMIT_MIN.into(),
            ObjectAddress::new(0x607D, 1),
            32,
        ),
        (
            obj::SOFTWARE_LIMIT_MAX.into(),
            ObjectAddress::new(0x607D, 2),
            32,
        ),
    ]);
}

#[test]
pub(super) fn drive_keeps_its_limits_in_its_eeprom() {
    let mut drive = drive();
    drive.set_sub(0x607D, 1, -100);
    drive.set_sub(0x607D, 2, 100);
    drive.axis.save();
    let again = drive.axis.restarted();
    let kept = [1, 2].map(|subindex| again.get(0x607D, subindex));
    assert_eq!(kept, [Some(-100), Some(100)]);
}

#[test]
pub(super) fn drive_has_607fh_as_the_table_says() {
    let mut drive = drive();
    let (kind, access, mapping) = drive.attributes(0x607F, 0);
    assert_eq!((kind, access), (DataType::U32, Access::ReadWrite));
    assert!(matches!(mapping, Mapping::Rx | Mapping::Both));
    assert_eq!(drive.get(0x607F), 2_147_483_647, "default");
    for value in [0, 4_294_967_295, 12_345] {
        drive.set(0x607F, value);
        assert_eq!(drive.get(0x607F), value);
    }
    drive.axis.save();
    assert_eq!(drive.axis.restarted().get(0x607F, 0), Some(12_345), "kept");
    assert_eq!(wire().map(0x1C12, 0x1600, &[0x607F_0020]), Ok(()));
}

#[test]
pub(super) fn library_has_607fh_as_the_table_says() {
    assert_bits(&[(
        obj::MAX_PROFILE_VELOCITY.into(),
        ObjectAddress::new(0x607F, 0),
        32,
    )]);
}
