//! What the program asks for: anything that the axis may take, and often what it may not.

use servocrab::axis::Command;
use servocrab::ds402::Mode;
use servocrab::profile_velocity::JogSetPoint;
use servocrab::{
    BufferMode, SetPoint,
    profile_position::{MoveCommand, Reference},
};
use servocrab::{HomingMethod, homing::HomingCommand};

use crate::random::Random;
use crate::scenario::Scenario;

impl Scenario {
    pub fn choose(&self, random: &mut Random) -> Command {
        let snapshot = self.host.snapshot();
        let roll = random.below(100);
        if snapshot.controlword.bits() & 0xF != 0xF {
            return if snapshot.state.is_fault() && roll < 60 {
                Command::ResetFault
            } else if roll < 80 {
                Command::Enable
            } else {
                random.pick(&[
                    Command::Disable,
                    Command::Stop,
                    Command::QuickStop,
                    Command::Halt,
                    Command::Resume,
                    Command::ResetFault,
                ])
            };
        }
        if roll < 60 && snapshot.halted && random.one_in(2) {
            return Command::Resume;
        }
        if roll < 60 {
            return match snapshot.mode {
                Mode::Homing => Command::Home(HomingCommand {
                    method: random.pick(&[HomingMethod(1), HomingMethod(17), HomingMethod(35)]),
                    offset: None,
                    until: None,
                }),
                Mode::ProfileVelocity => {
                    Command::Jog(JogSetPoint::new(random.between(-9_000, 9_000)))
                }
                _ => self.any_move(random),
            };
        }
        let modes: &[Mode] = if self.program.homes {
            &[
                Mode::ProfilePosition,
                Mode::Homing,
                Mode::Homing,
                Mode::ProfileVelocity,
                Mode::ProfileVelocity,
                Mode::CyclicPosition,
            ]
        } else {
            &[Mode::ProfilePosition]
        };
        let mode = random.pick(modes);
        random.pick(&[
            Command::Halt,
            Command::Halt,
            Command::Resume,
            Command::Resume,
            Command::Stop,
            Command::QuickStop,
            Command::Disable,
            Command::Release,
            Command::Enable,
            Command::SelectMode(mode),
            Command::SelectMode(mode),
            Command::SelectMode(Mode::ProfilePosition),
            Command::ResetFault,
        ])
    }

    fn any_move(&self, random: &mut Random) -> Command {
        let position = self.host.snapshot().position;
        let far = if random.one_in(2) {
            self.program.far
        } else {
            1
        };
        let relative = random.one_in(3);
        let (reference, target) = if relative {
            let distance = random.pick(&[0, 5, -5, 40, 1000, -700, 3000]);
            (Reference::Relative, distance)
        } else {
            let target = match random.below(5) {
                0 => position,
                1 => position + random.between(-40, 40),
                2 => 1000,
                _ => far * random.between(-4_000, 4_000),
            };
            (Reference::Absolute, self.in_turn(target))
        };
        let start = random.pick(&[
            BufferMode::Aborting,
            BufferMode::Buffered,
            BufferMode::Buffered,
            BufferMode::Blending,
        ]);
        let gated = random.one_in(10);
        let passes = self.program.end_velocity.filter(|_| random.one_in(3));
        self.a_move(reference, target, start, gated, passes)
    }

    /// Of a modulo axis where in its turn that is.
    pub fn in_turn(&self, position: i32) -> i32 {
        match self.drive.making.turn {
            Some((least, length)) => {
                (least + (i64::from(position) - least).rem_euclid(length)) as i32
            }
            None => position,
        }
    }

    /// A move whose velocity is its name.
    pub fn a_move(
        &self,
        reference: Reference,
        target: i32,
        buffer_mode: BufferMode,
        gated: bool,
        passes: Option<u32>,
    ) -> Command {
        let velocity = self.program.speed + self.issued.len() as u32;
        let mut set_point = SetPoint::new()
            .velocity(velocity)
            .acceleration(self.program.ramp)
            .deceleration(self.program.ramp)
            .buffer_mode(buffer_mode);
        if let Some(velocity) = passes {
            set_point = set_point.end_velocity(velocity);
        }
        Command::Move(MoveCommand {
            reference,
            target,
            set_point,
            gated,
        })
    }
}
