//! The positioning option code (60F2h): what relative targets count from, what bit 5 of the controlword does, who resets
//! bit 4, and which way a modulo axis turns.
//!
//! Bits after the pages of Nanotec and of Novanta on 60F2h; bits 2 and 3 after IEC 61800-7-201 as they cite it.

use super::axis::Axis;
use super::behaviour::RelativeBase;
use super::motion::PROFILE_POSITION;
use super::objects;

/// Bits 2 and 3: what a set-point with bit 5 = 1 does.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Change {
    /// The active one is left at once.
    AtOnce,
    /// The active one's target is passed without stopping.
    ThroughTarget,
    /// The active one is ended.
    AfterTarget,
}

/// Bits 4 and 5: who resets bit 4 of the controlword.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Request {
    /// The master.
    Master,
    /// The drive, when the target is reached.
    WhenReached,
    /// The drive, as soon as it can take another set-point.
    WhenReady,
}

/// Bits 6 and 7: the way of a modulo axis to an absolute target.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Direction {
    /// As on a linear axis, not over the ends of the range.
    Linear,
    Negative,
    Positive,
    Shortest,
}

/// 60F2h, decoded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Positioning {
    pub(super) base: RelativeBase,
    pub(super) change: Change,
    pub(super) request: Request,
    pub(super) direction: Direction,
}

impl Positioning {
    /// None for a value with reserved bits or codes.
    pub(super) fn decode(value: i64) -> Option<Positioning> {
        let code = |low: u32| value >> low & 3;
        if !(0..0x100).contains(&value) {
            return None;
        }
        Some(Positioning {
            base: match code(0) {
                0 => RelativeBase::PreviousTarget,
                1 => RelativeBase::Demand,
                2 => RelativeBase::Actual,
                _ => return None,
            },
            change: match code(2) {
                0 => Change::AtOnce,
                1 => Change::ThroughTarget,
                2 => Change::AfterTarget,
                _ => return None,
            },
            request: match code(4) {
                0 => Request::Master,
                1 => Request::WhenReached,
                2 => Request::WhenReady,
                _ => return None,
            },
            direction: match code(6) {
                0 => Direction::Linear,
                1 => Direction::Negative,
                2 => Direction::Positive,
                _ => Direction::Shortest,
            },
        })
    }

    /// All bits 0, which is what a drive without 60F2h does.
    const PLAIN: Positioning = Positioning {
        base: RelativeBase::PreviousTarget,
        change: Change::AtOnce,
        request: Request::Master,
        direction: Direction::Linear,
    };
}

impl Axis {
    /// How set-points are taken: by 60F2h, its base by a fixed one where the drive has that.
    pub(super) fn positioning(&self) -> Positioning {
        let value = self.objects.value(objects::POSITIONING_OPTION);
        let option = Positioning::decode(value).unwrap_or(Positioning::PLAIN);
        match self.behaviour.relative_base {
            RelativeBase::PositioningOption => option,
            base => Positioning { base, ..option },
        }
    }

    /// Resets bit 4 of the controlword where the drive has to do so. A master that writes the controlword with every
    /// frame writes it back, which is no edge.
    pub(super) fn reset_request(&mut self) {
        let bit_4 = 0x0010;
        if self.objects.value(objects::MODE_DISPLAY) != PROFILE_POSITION {
            return;
        }
        let reset = match self.positioning().request {
            Request::Master => false,
            Request::WhenReached => self.buffer.is_empty() && self.statusword() & 0x0400 != 0,
            Request::WhenReady => !self.buffer.is_full(self.behaviour.waiting_set_points),
        };
        if reset && self.last_controlword & bit_4 != 0 {
            let word = self.objects.value(objects::CONTROLWORD) & !i64::from(bit_4);
            self.objects.put(objects::CONTROLWORD, word);
        }
    }
}
