//! Scenarios that the first ones do not see: drives of whose buffer nothing is documented, that overwrite what waits, that answer
//! late; frames that are lost exactly where bits 4 and 12 change, with the drive in another state when it is heard again;
//! many commands in one cycle.

use servocrab::axis::CoreConfig;
use servocrab::ds402::QuickStopOption;
use servocrab::profile_position::{BufferSignal, RelativeBase};
use servocrab_sim::ds402::{
    AckPolicy, Axis, Behaviour, FullBuffer, LimitViolation, RelativeBase as SimBase,
};

use super::world::World;
use crate::frames::Link;
use crate::frames::Random;

/// Set in the seeds of such scenarios.
const WIDER: u32 = 48;

/// The seed of such a scenario.
pub const fn wider(seed: u64) -> u64 {
    seed | 1 << WIDER
}

/// What is chosen for such a scenario beside what is chosen for every scenario.
pub struct Wider {
    random: Random,
    /// Positioning option code 60F2h of a drive whose relative moves count from what that says.
    positioning: i64,
    /// Cycles by which every acknowledge is late.
    late: u32,
    /// One change of bit 4 or 12 in so many is followed by lost frames.
    hits: u64,
    /// Enable operation, as it is sent on, leads the drive back from a stop of its own (transition 16): unseen, nothing can
    /// tell of it.
    comes_back: bool,
    /// One cycle in so many with a command has many.
    volleys: u64,
    seen: (bool, bool),
}

impl Wider {
    pub fn of(seed: u64) -> Option<Self> {
        if seed >> WIDER & 1 == 0 {
            return None;
        }
        let mut random = Random::new(!seed);
        Some(Self {
            positioning: random.pick(&[0, 1, 2]),
            late: random.pick(&[0, 0, 1, 2, 7, 20]),
            hits: random.pick(&[0, 2, 6]),
            comes_back: false,
            volleys: random.pick(&[0, 2, 5]),
            seen: (false, false),
            random,
        })
    }

    /// Another drive, and what the program knows of it.
    pub fn change(&mut self, behaviour: &mut Behaviour, config: &mut CoreConfig) {
        self.comes_back = behaviour.transition_16;
        let random = &mut self.random;
        let traits = &mut config.traits;
        if behaviour.ack != AckPolicy::BufferFree {
            // "Setpoint overwriting will be accepted" (AKD2G).
            behaviour.full_buffer =
                random.pick(&[FullBuffer::Ignore, FullBuffer::OverwritePending]);
        }
        if random.one_in(2) {
            traits.buffer_signal = BufferSignal::Unknown;
        }
        if traits.buffer_signal != BufferSignal::Acknowledge {
            behaviour.waiting_set_points = random.pick(&[1, 1, 3]);
        }
        behaviour.limit_violation = random.pick(&[
            LimitViolation::Clamp,
            LimitViolation::Refuse,
            LimitViolation::Fault,
        ]);
        if !behaviour.without.contains(&0x60F2) && random.one_in(2) {
            behaviour.relative_base = SimBase::PositioningOption;
        }
        let base = match behaviour.relative_base {
            SimBase::PositioningOption => {
                RelativeBase::of_positioning_option(self.positioning as u16)
            }
            SimBase::PreviousTarget => RelativeBase::PreviousTarget,
            SimBase::Demand => RelativeBase::Demand,
            SimBase::Actual => RelativeBase::Actual,
        };
        traits.relative_base = random.pick(&[base, base, RelativeBase::Undocumented]);
        if random.one_in(8) {
            // Somebody has changed it since it was read.
            behaviour.quick_stop_option = random.pick(&[1, 2, 5, 6]);
            config.quick_stop = QuickStopOption(random.pick(&[1, 2, 5, 6]));
        }
    }

    /// What the drive holds besides.
    pub fn set_up(&self, drive: &mut Axis) {
        if drive.get(0x60F2, 0).is_some() {
            drive
                .set(0x60F2, 0, self.positioning)
                .expect("a positioning option");
        }
        drive.disturbances().ack_delay_cycles = self.late;
    }

    pub const fn late(&self) -> u32 {
        self.late
    }

    /// Frames lost where the handshake is, and how many more.
    pub fn hit(&mut self, world: &mut World) -> Option<(Link, u64)> {
        let bit_4 = world.outputs_now().bit(4);
        let bit_12 = world
            .frames
            .last()
            .and_then(|frame| frame.sample)
            .map_or(self.seen.1, |sample| sample.bit(12));
        let before = core::mem::replace(&mut self.seen, (bit_4, bit_12));
        if before == self.seen || self.hits == 0 || !self.random.one_in(self.hits) {
            return None;
        }
        let random = &mut self.random;
        if random.one_in(4) {
            let drive = &mut world.drive;
            match random.below(3) {
                0 => drive.inject_fault(0x7305),
                1 if !self.comes_back => {
                    drive.connection_lost();
                    drive.connection_restored();
                }
                _ => {
                    drive.set_voltage(false);
                    drive.set_voltage(true);
                }
            }
        }
        let link = random.pick(&[
            Link::RequestLost,
            Link::ReplyLost,
            Link::Miscounted,
            Link::Undelivered,
        ]);
        Some((link, random.pick(&[0, 0, 1, 2, 4, 9, 12, 30])))
    }

    /// How many more commands come in a cycle with one.
    pub fn volley(&mut self) -> u64 {
        if self.volleys > 0 && self.random.one_in(self.volleys) {
            1 + self.random.below(6)
        } else {
            0
        }
    }
}
