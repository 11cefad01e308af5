//! 5000h:4 and 5100h:4, by SDO.

use servocrab::SetPoint;
use servocrab::drives;
use servocrab::{Failure, Referencing, axis::Completion};
use servocrab_sim::ds402::Behaviour;
use servocrab_sim::personality;

use crate::common::Rig;
use crate::wire::Wire;

/// Homes where it stands, and a method that no drive knows.
const HERE: u8 = 37;
const UNKNOWN: u8 = 36;

struct Drive(Wire);

impl Drive {
    /// Axis 2, enabled in this mode.
    fn enabled(mode: u8) -> Self {
        let mut drive = Self(Wire::new(personality::akd2g()));
        drive.0.run(10);
        drive.mode(mode);
        for word in [0x06, 0x07, 0x0F] {
            drive.word(word);
        }
        drive
    }

    fn set(&mut self, index: u16, data: &[u8]) {
        assert_eq!(self.0.download(index, 0, data), Ok(()), "{index:04X}h");
    }

    fn mode(&mut self, mode: u8) {
        self.set(0x6860, &[mode]);
        self.0.run(10);
    }

    fn word(&mut self, word: u16) {
        self.set(0x6840, &word.to_le_bytes());
        self.0.run(10);
    }

    /// These bits of the motion status of axis 2, as a number of their own; axis 1 shows none of a homing.
    fn shows(&mut self, bits: &[u32]) -> Vec<bool> {
        let read = |wire: &mut Wire, index| {
            let bytes = wire.upload(index, 4).expect("it is there");
            u32::from_le_bytes(bytes.try_into().expect("32 bits"))
        };
        assert_eq!(read(&mut self.0, 0x5000) & 0x1E, 0);
        let value = read(&mut self.0, 0x5100);
        bits.iter().map(|bit| value >> bit & 1 == 1).collect()
    }

    fn homes(&mut self, method: u8) {
        self.set(0x6898, &[method]);
        self.word(0x0F);
        self.word(0x1F);
        self.0.run(200);
    }
}

#[test]
pub(super) fn drive_shows_a_move_and_its_end() {
    let mut drive = Drive::enabled(1);
    for (index, value) in [
        (0x6881, 10_000_u32),
        (0x6883, 100_000),
        (0x6884, 100_000),
        (0x687A, 5_000),
    ] {
        drive.set(index, &value.to_le_bytes());
    }
    assert_eq!(drive.shows(&[0, 11, 15]), [false, true, true]);
    drive.word(0x1F);
    drive.0.run(200);
    assert_eq!(drive.shows(&[0, 11, 15]), [true, false, false]);
    drive.0.run(2_000);
    assert_eq!(drive.shows(&[0, 11, 15]), [false, true, true]);
}

#[test]
pub(super) fn drive_shows_that_the_homing_is_done() {
    let mut drive = Drive::enabled(6);
    assert_eq!(drive.shows(&[1, 2, 4]), [false; 3]);
    drive.homes(HERE);
    assert_eq!(drive.shows(&[1, 2, 4]), [true, true, false]);
    drive.mode(1);
    drive.word(0x00);
    assert_eq!(drive.shows(&[1, 2, 4]), [true, true, false], "it stays");
}

#[test]
pub(super) fn drive_shows_a_homing_and_its_error() {
    let mut drive = Drive::enabled(6);
    // Without a switch to find it goes on.
    drive
        .0
        .download(0x6899, 1, &1_000_u32.to_le_bytes())
        .expect("a speed");
    drive
        .0
        .download(0x689A, 0, &10_000_u32.to_le_bytes())
        .expect("a ramp");
    drive.homes(17);
    assert_eq!(drive.shows(&[2, 3, 4]), [false, true, false]);
    drive.homes(UNKNOWN);
    assert_eq!(drive.shows(&[2, 3, 4]), [false, false, true]);
    drive.homes(HERE);
    assert_eq!(drive.shows(&[2, 3, 4]), [true, false, false]);
}

/// An axis that attaches while the drive shows this.
fn attached(status: u32) -> Rig {
    let signal = drives::akd2g().traits.homed.expect("it shows it");
    let mut rig = Rig::new(Behaviour::akd2g(), |config| {
        config.referencing = Referencing::ByHoming;
        config.homed = signal.is_homed(status);
    })
    .ideal();
    rig.enable();
    rig
}

#[test]
pub(super) fn library_takes_homing_done_for_a_reference() {
    for status in [0b0_0110, 0x8806, 0b0_0100] {
        let mut rig = attached(status);
        assert!(rig.core.snapshot().referenced, "{status:04X}h");
        let id = rig.abs(5_000, SetPoint::new());
        assert_eq!(rig.finish(id), Ok(Completion::Reached { position: 5_000 }));
    }
}

#[test]
pub(super) fn library_takes_no_homing_under_way_or_failed_for_a_reference() {
    for status in [0, 0b0_0010, 0b0_1110, 0b1_0110, 0b1_0000] {
        let mut rig = attached(status);
        let id = rig.abs(5_000, SetPoint::new());
        assert_eq!(
            rig.outcome(id),
            Some(Err(Failure::NotReferenced)),
            "{status:04X}h"
        );
    }
}
