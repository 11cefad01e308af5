//! Habits that real devices have and the standard does not: late replies, emergencies around replies, refusals, falls.

use core::time::Duration;

use super::Device;
use crate::al::AlState;
use crate::coe::{Abort, emergency_payload, refusal};

/// What a device does otherwise than its kind should. Messages are counted from 0, from the moment in which the habits were set.
///
/// ```
/// use core::time::Duration;
/// use servocrab_sim::{AlState, Habits, personality};
///
/// let mut drive = personality::generic();
/// // It answers its third mail two seconds late, and goes back to PREOP when it is asked for OP.
/// drive.set_habits(Habits {
///     late: Some((2, Duration::from_secs(2))),
///     falls: Some((AlState::Op, AlState::PreOp, 0x8001)),
///     ..Habits::default()
/// });
/// ```
#[derive(Clone, Debug, Default)]
pub struct Habits {
    /// The message that is answered late, and how late.
    pub late: Option<(u64, Duration)>,
    /// An emergency goes before, between the parts of, and behind every answer.
    pub emergencies: bool,
    /// The message that is refused, and why; nothing comes of it when that is no SDO request that names an object.
    pub refuses: Option<(u64, Abort)>,
    /// SDO information that it does not have is refused by a message of the mailbox (ETG.1000.4, 0004h: service not supported) in place
    /// of an SDO abort.
    pub refuses_information_by_mailbox: bool,
    /// When the first state is asked for, it falls into the second, or stays below it, with this AL status code.
    pub falls: Option<(AlState, AlState, u16)>,
    /// It looks at AL control this long after it was written, and sees what was written last.
    pub al_delay: Duration,
}

/// Habits at work.
#[derive(Clone, Debug, Default)]
pub(super) struct Practice {
    pub(super) habits: Habits,
    messages: u64,
    emergencies: u32,
    /// What AL control holds, and when it is looked at.
    asked: Option<(u16, Duration)>,
}

impl Practice {
    /// AL control, once the device looks at it. `written` is what was written to it since the last call.
    pub(super) fn al_control(&mut self, written: Option<u16>, now: Duration) -> Option<u16> {
        if let Some(control) = written {
            let at = now.saturating_add(self.habits.al_delay);
            self.asked = Some((control, self.asked.map_or(at, |(_, at)| at)));
        }
        let (control, _) = self.asked.take_if(|(_, at)| *at <= now)?;
        Some(control)
    }

    /// A reply in place of what the device would answer, to the next message.
    pub(super) fn refuse(&mut self, payload: &[u8]) -> Option<Vec<u8>> {
        let number = self.messages;
        self.messages += 1;
        let (refused, abort) = self.habits.refuses?;
        (refused == number).then(|| refusal(payload, abort))?
    }

    /// The replies with what goes around them.
    pub(super) fn surround(&mut self, replies: Vec<Vec<u8>>) -> Vec<Vec<u8>> {
        if !self.habits.emergencies {
            return replies;
        }
        let mut all = vec![self.emergency()];
        for reply in replies {
            all.push(reply);
            all.push(self.emergency());
        }
        all
    }

    /// Each has its number in its last four bytes.
    fn emergency(&mut self) -> Vec<u8> {
        let [a, b, c, d] = self.emergencies.to_le_bytes();
        self.emergencies += 1;
        emergency_payload(0xFF00, 0x81, [0, a, b, c, d])
    }
}

impl Device {
    /// Gives the device habits in place of those that it had.
    pub fn set_habits(&mut self, habits: Habits) {
        self.mailbox.late = habits.late;
        self.practice = Practice {
            habits,
            emergencies: self.practice.emergencies,
            ..Practice::default()
        };
    }

    /// How many emergencies it has sent because it has the habit.
    #[must_use]
    pub fn habitual_emergencies(&self) -> u32 {
        self.practice.emergencies
    }

    /// Makes the device fall to a state, or stay below it, with an error, as after a fault of its own.
    pub fn fall_to(&mut self, state: AlState, al_status_code: u16) {
        let before = self.al.state();
        self.al.fall(state, al_status_code);
        self.after_al(before);
    }
}
