//! Scenarios with drives that are seldom met: deaf for a while to bit 8 or to bit 2, without an error code 603Fh, with the bits of a
//! homing under way before it has begun.

use servocrab::axis::{Command, CoreConfig};
use servocrab_sim::ds402::{Axis, Behaviour};

use crate::frames::Random;

/// Set in the seeds of such scenarios.
const RARER: u32 = 49;

/// The seed of such a scenario.
pub const fn rarer(seed: u64) -> u64 {
    seed | 1 << RARER
}

/// What is chosen for such a scenario beside what is chosen for every scenario.
pub struct Rarer {
    random: Random,
    /// One cycle in motion in so many begins a time in which the drive does not obey a stop; 0 for none.
    deaf: u64,
    /// The cycles that are left of it.
    left: u64,
    /// The stop with which it begins, after which nobody asks for anything while it lasts.
    stop: Option<Command>,
    silent: bool,
}

impl Rarer {
    /// How many times as far as in other scenarios some of the moves go: only an axis that is under way for long can be seen to run on.
    pub const FAR: i32 = 20;

    pub fn of(seed: u64) -> Option<Self> {
        if seed >> RARER & 1 == 0 {
            return None;
        }
        let mut random = Random::new(seed.rotate_left(17));
        Some(Self {
            deaf: random.pick(&[0, 300, 100, 30]),
            left: 0,
            stop: None,
            silent: false,
            random,
        })
    }

    /// Another drive, and what the program knows of it.
    pub fn change(&mut self, behaviour: &mut Behaviour, config: &mut CoreConfig) {
        if behaviour.without.is_empty() && self.random.one_in(2) {
            behaviour.without = &[0x603F];
            config.fields.error_code = None;
        }
    }

    pub fn set_up(&mut self, drive: &mut Axis) {
        drive.disturbances().progress_before_homing = self.random.one_in(2);
    }

    /// One cycle. Whether the drive does not obey a stop in it.
    pub fn pass(&mut self, drive: &mut Axis) -> bool {
        if self.left > 0 {
            self.left -= 1;
        } else if self.deaf > 0
            && drive.velocity() != 0.0
            && !drive.stands()
            && self.random.one_in(self.deaf)
        {
            self.left = self.random.pick(&[5, 100, 400, 1_500]);
            let (halt, quick_stop) =
                self.random
                    .pick(&[(true, false), (false, true), (true, true)]);
            drive.disturbances().deaf_to_halt = halt;
            drive.disturbances().deaf_to_quick_stop = quick_stop;
            self.silent = self.random.one_in(2);
            let stops = [Command::Halt, Command::Stop, Command::QuickStop];
            let stop = self.random.pick(&stops);
            self.stop = self.silent.then_some(stop);
        } else {
            self.silent = false;
            Self::heal(drive);
        }
        self.left > 0
    }

    pub fn far(&mut self) -> i32 {
        self.random.pick(&[1, Self::FAR])
    }

    pub fn stop(&mut self) -> Option<Command> {
        self.stop.take()
    }

    pub const fn is_silent(&self) -> bool {
        self.silent
    }

    /// The drive obeys again.
    pub fn heal(drive: &mut Axis) {
        drive.disturbances().deaf_to_halt = false;
        drive.disturbances().deaf_to_quick_stop = false;
    }
}
