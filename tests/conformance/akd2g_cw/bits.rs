//! The bit assignment, the mode-dependent bits, bit 8, and the object itself.

use servocrab::coe::{AxisOffset, obj};
use servocrab::ds402::{Controlword, Mode};
use servocrab::pdo_map::{Direction, Mapping as PdoMapping};
use servocrab::{BufferMode, SetPoint};
use servocrab::{
    Failure,
    axis::{Command, Completion},
};
use servocrab_sim::ds402::{Access, Behaviour, DataType, Mapping, State};
use servocrab_sim::personality;

use crate::bench::{Drive, VELOCITY, assert_near};
use crate::common::Rig;
use crate::wire::Wire;

fn akd2g() -> Drive {
    Drive::enabled(Behaviour::akd2g())
}

/// That a bit changes neither state nor motion.
fn has_no_effect(bit: u16) {
    let mut drive = akd2g();
    drive.start(0x0F, 20_000);
    drive.run(300);
    drive.word(0x1F | bit);
    drive.run(100);
    assert_eq!(drive.state(), State::OperationEnabled, "{bit:04X}h");
    assert_near(drive.axis.velocity(), VELOCITY as f64);
    drive.word(0x0F | bit);
    drive.settle();
    assert_eq!(drive.axis.position(), 20_000);
    assert_eq!(drive.outcomes().len(), 1);
}

#[test]
pub(super) fn drive_has_no_use_for_bit_10() {
    has_no_effect(1 << 10);
}

#[test]
pub(super) fn library_never_sends_bit_10() {
    let mut rig = Rig::ideal_enabled();
    rig.core
        .set_manufacturer_bits(Controlword::from_bits_retain(0xFFFF));
    let id = rig.abs(5_000, SetPoint::new());
    assert!(rig.finish(id).is_ok());
    assert!(rig.words.iter().all(|word| word & 0x0400 == 0));
}

#[test]
pub(super) fn drive_leaves_bits_11_to_15_to_its_maker() {
    for bit in 11..=15 {
        has_no_effect(1 << bit);
    }
}

#[test]
pub(super) fn library_leaves_bits_11_to_15_to_the_program() {
    let mut rig = Rig::ideal_enabled();
    assert!(rig.words.iter().all(|word| word & 0xF800 == 0));
    rig.core
        .set_manufacturer_bits(Controlword::from_bits_retain(0x9000));
    let id = rig.abs(5_000, SetPoint::new());
    rig.run(2);
    let from = rig.words.len();
    assert!(rig.finish(id).is_ok());
    assert!(rig.words[from..].iter().all(|word| word & 0xF800 == 0x9000));
    assert_eq!(rig.ledger().len(), 1);
}

/// The modes of the table that CiA 402 numbers.
const MODES: [i64; 6] = [8, 9, 6, 1, 4, 3];

#[test]
pub(super) fn drive_takes_the_mode_from_6060h() {
    let mut drive = Drive::new(Behaviour::akd2g());
    for mode in MODES {
        drive.set(0x6060, mode);
        drive.run(3);
        assert_eq!(drive.get(0x6061), mode);
        assert!(drive.get(0x6502) & 1 << (mode - 1) != 0, "6502h, {mode}");
    }
    drive.set(0x6060, 2);
    drive.run(3);
    assert_eq!(drive.get(0x6061), 3, "2 is not in the table");
}

#[test]
pub(super) fn library_selects_the_mode_by_6060h() {
    let mut rig = Rig::ideal_enabled();
    for (mode, number) in [
        (Mode::CyclicPosition, 8),
        (Mode::CyclicVelocity, 9),
        (Mode::Homing, 6),
        (Mode::Other(4), 4),
        (Mode::ProfileVelocity, 3),
        (Mode::ProfilePosition, 1),
    ] {
        let id = rig.send(Command::SelectMode(mode));
        assert_eq!(rig.finish(id), Ok(Completion::Done));
        assert_eq!(rig.drive.get(0x6060, 0), Some(number));
        assert_eq!(rig.mode(), mode);
    }
}

#[test]
pub(super) fn drive_has_no_use_for_the_mode_bits_elsewhere() {
    for mode in [3, 4, 8, 9] {
        let mut drive = akd2g();
        drive.set(0x6060, mode);
        drive.set(0x607A, drive.axis.position());
        drive.run(3);
        for bits in [0x10, 0x20, 0x40, 0x200, 0x270] {
            drive.word(0x0F);
            drive.word(0x0F | bits);
            assert!(!drive.moves(), "mode {mode}, bits {bits:03X}h");
        }
        assert!(drive.outcomes().is_empty());
        assert_eq!(drive.state(), State::OperationEnabled);
    }
}

#[test]
pub(super) fn library_sends_no_set_point_in_another_mode() {
    let mut rig = Rig::ideal_enabled();
    let id = rig.send(Command::SelectMode(Mode::Other(4)));
    assert!(rig.finish(id).is_ok());
    let from = rig.words.len();
    let refused = rig.abs(5_000, SetPoint::new());
    assert!(matches!(
        rig.outcome(refused),
        Some(Err(Failure::WrongMode { .. }))
    ));
    rig.run(50);
    assert_eq!(rig.distinct_words(from), [0x0F]);
    assert!(rig.ledger().is_empty());
}

#[test]
pub(super) fn drive_knows_the_four_bits_of_profile_position() {
    for (word, bit_5, relative, bit_9) in [
        (0x1F, false, false, false),
        (0x3F, true, false, false),
        (0x5F, false, true, false),
        (0x21F, false, false, true),
    ] {
        let mut drive = akd2g();
        drive.set(0x607A, 5_000);
        drive.word(word);
        let line = &drive.axis.ledger()[0];
        assert_eq!(
            (line.bit_5, line.relative, line.bit_9),
            (bit_5, relative, bit_9),
            "{word:03X}h"
        );
    }
}

#[test]
pub(super) fn library_knows_the_four_bits_of_profile_position() {
    for (start, relative, word) in [
        (BufferMode::Buffered, false, 0x1F),
        (BufferMode::Aborting, false, 0x3F),
        (BufferMode::Blending, false, 0x21F),
        (BufferMode::Buffered, true, 0x5F),
        (BufferMode::Aborting, true, 0x7F),
    ] {
        let mut rig = Rig::ideal_enabled();
        let set_point = SetPoint::new().buffer_mode(start);
        let id = if relative {
            rig.rel(5_000, set_point)
        } else {
            rig.abs(5_000, set_point)
        };
        rig.wait_accepted(id);
        let sent = rig.words.iter().find(|word| **word & 0x10 != 0);
        assert_eq!(sent, Some(&word), "{start:?}");
    }
}

#[test]
pub(super) fn drive_has_a_controlword_for_each_axis() {
    let (kind, access, mapping) = akd2g().attributes(0x6040, 0);
    assert_eq!((kind, access), (DataType::U16, Access::ReadWrite));
    assert!(matches!(mapping, Mapping::Rx | Mapping::Both));
    let mut wire = Wire::new(personality::akd2g());
    for (index, word) in [(0x6040, 0x0006_u16), (0x6840, 0x0000)] {
        wire.download(index, 0, &word.to_le_bytes())
            .expect("it can be written");
        assert_eq!(wire.upload(index, 0), Ok(word.to_le_bytes().to_vec()));
    }
    wire.run(5);
    let line = wire.line.clone();
    let states = [0, 1].map(|axis| line.segment().axis(0, axis).expect("two axes").state());
    assert_eq!(states, [State::ReadyToSwitchOn, State::SwitchOnDisabled]);
    assert_eq!(
        wire.map(0x1C12, 0x1600, &[0x6040_0010, 0x6840_0010]),
        Ok(())
    );
}

#[test]
pub(super) fn library_has_a_controlword_for_each_axis() {
    for (axis, index) in [(1, 0x6040), (2, 0x6840)] {
        let layout = PdoMapping::builder()
            .offset(AxisOffset::of_axis(axis))
            .rx_pdo(0x1600)
            .output(obj::CONTROLWORD)
            .build()
            .expect("a mapping")
            .layout();
        let place = layout.find(Direction::Outputs, index, 0).expect("mapped");
        assert_eq!(place.bits, 16);
    }
}
