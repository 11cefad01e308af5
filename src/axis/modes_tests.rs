//! Modes against a drive that is played word by word: what a simulated one never does.

use core::time::Duration;

use super::{
    AxisCore, AxisFields, Command, CommandId, Completion, CoreConfig, Delivery, Event, Failure,
    Inputs,
};
use crate::{
    ds402::Mode,
    homing::{HomingCommand, HomingMethod},
    profile_velocity::JogSetPoint,
};

/// Outputs: 6040h, 607Ah, 6060h, 60FFh. Inputs: 6041h, 6064h, 6061h, 606Ch.
const FIELDS: AxisFields = AxisFields {
    mode: Some(6),
    target_velocity: Some(7),
    mode_display: Some(6),
    actual_velocity: Some(7),
    ..AxisFields::at(0, 0)
};

struct Played {
    core: AxisCore,
    outputs: [u8; 11],
    now: Duration,
    mode: i8,
    position: i32,
    velocity: i32,
    last: u32,
}

impl Played {
    /// In Operation enabled, in this mode.
    fn enabled(mode: Mode) -> Self {
        let mut this = Self {
            core: AxisCore::new(CoreConfig::new(FIELDS)),
            outputs: [0; 11],
            now: Duration::ZERO,
            mode: 1,
            position: 0,
            velocity: 0,
            last: 0,
        };
        let enabling = this.submit(Command::Enable);
        for statusword in [
            0x0250, 0x0250, 0x0250, 0x0231, 0x0233, 0x0237, 0x0237, 0x0237,
        ] {
            this.shows(statusword);
        }
        assert_eq!(this.outcome(enabling), Some(Ok(Completion::Done)));
        let selecting = this.submit(Command::SelectMode(mode));
        for _ in 0..30 {
            this.shows(0x0637);
            this.mode = this.outputs[6] as i8;
        }
        assert_eq!(this.outcome(selecting), Some(Ok(Completion::Done)));
        this
    }

    fn submit(&mut self, command: Command) -> CommandId {
        self.last += 1;
        let id = CommandId(self.last);
        self.core.submit(self.now, id, command, &mut self.outputs);
        id
    }

    fn shows(&mut self, statusword: u16) {
        self.now += Duration::from_millis(1);
        let mut inputs = [0; 11];
        self.position += self.velocity;
        inputs[2..6].copy_from_slice(&self.position.to_le_bytes());
        inputs[..2].copy_from_slice(&statusword.to_le_bytes());
        inputs[6] = self.mode as u8;
        inputs[7..].copy_from_slice(&self.velocity.to_le_bytes());
        self.core
            .step(self.now, Inputs::Fresh(&inputs), &mut self.outputs);
    }

    fn shows_for(&mut self, cycles: u32, statusword: u16) {
        for _ in 0..cycles {
            self.shows(statusword);
        }
    }

    /// The last report of this command among those that were not taken yet.
    fn outcome(&mut self, of: CommandId) -> Option<Result<Completion, Failure>> {
        core::iter::from_fn(|| self.core.poll_event())
            .filter_map(|(id, event)| match event {
                Event::Done(result) if id == of => Some(result),
                _ => None,
            })
            .last()
    }

    fn word(&self) -> u16 {
        u16::from_le_bytes([self.outputs[0], self.outputs[1]])
    }

    fn target_velocity(&self) -> i32 {
        i32::from_le_bytes([
            self.outputs[7],
            self.outputs[8],
            self.outputs[9],
            self.outputs[10],
        ])
    }
}

fn by_switch() -> Command {
    Command::Home(HomingCommand {
        method: HomingMethod::NEGATIVE_LIMIT,
        offset: None,
        until: None,
    })
}

#[test]
fn a_homing_error_that_does_not_come_to_rest_is_ended_by_a_quick_stop() {
    let mut drive = Played::enabled(Mode::Homing);
    let homing = drive.submit(by_switch());
    drive.shows_for(4, 0x0637);
    assert_eq!(drive.word(), 0x001F);
    drive.velocity = -300;
    drive.shows_for(20, 0x0237);
    // An error, and it goes on moving, for longer than a standstill may take.
    drive.shows_for(9_990, 0x2237);
    assert_eq!((drive.outcome(homing), drive.word()), (None, 0x001F));
    drive.shows_for(20, 0x2237);
    let moving = Failure::HomingError { moving: true };
    assert_eq!(drive.outcome(homing), Some(Err(moving)));
    assert_eq!(drive.word() & 0x0004, 0, "bit 2 is low");
    drive.velocity = 0;
    drive.shows_for(20, 0x0250);
    assert_eq!(drive.word() & 0x0010, 0);
    assert!(!drive.core.snapshot().has_set_point);
}

#[test]
fn a_drive_that_leaves_the_mode_by_itself_is_stopped_with_nothing_left_in_the_outputs() {
    let wrong = |expected| Failure::WrongMode {
        delivery: Delivery::Accepted,
        expected,
        shown: Mode::ProfilePosition,
    };
    let mut drive = Played::enabled(Mode::Homing);
    let homing = drive.submit(by_switch());
    drive.shows_for(4, 0x0637);
    drive.shows_for(20, 0x0237);
    drive.mode = 1;
    drive.shows(0x0237);
    assert_eq!(drive.outcome(homing), Some(Err(wrong(Mode::Homing))));
    assert_eq!(drive.word() & 0x0004, 0, "bit 2 is low");

    let mut drive = Played::enabled(Mode::ProfileVelocity);
    let jog = drive.submit(Command::Jog(JogSetPoint::new(-700)));
    assert_eq!(drive.target_velocity(), -700);
    drive.shows_for(5, 0x0237);
    drive.mode = 1;
    drive.shows(0x0237);
    assert_eq!(drive.outcome(jog), Some(Err(wrong(Mode::ProfileVelocity))));
    assert_eq!(drive.target_velocity(), 0);
    assert_eq!(drive.word() & 0x0004, 0, "bit 2 is low");
}

#[test]
fn a_jog_that_was_let_go_is_at_rest_only_after_the_drive_has_had_the_zero() {
    let mut drive = Played::enabled(Mode::ProfileVelocity);
    let jog = drive.submit(Command::Jog(JogSetPoint::new(700)));
    drive.shows(0x0237);
    let (core, outputs) = (&mut drive.core, &mut drive.outputs);
    assert!(core.release_jog(drive.now, jog, outputs));
    assert_eq!(drive.target_velocity(), 0);
    // What it shows is the rest from which it is only just starting.
    drive.shows(0x0237);
    drive.shows(0x0237);
    assert_eq!(drive.outcome(jog), None);
    drive.velocity = 40;
    drive.shows_for(50, 0x0237);
    assert_eq!(drive.outcome(jog), None);
    drive.velocity = 0;
    drive.shows_for(14, 0x0637);
    assert!(matches!(
        drive.outcome(jog),
        Some(Ok(Completion::Stopped { .. }))
    ));
}
