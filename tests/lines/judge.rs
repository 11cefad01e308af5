//! What the drives did, and whether somebody had asked for it.

use std::{
    collections::BTreeMap,
    sync::{Arc, Mutex},
    time::Duration,
};

use servocrab_sim::{AlState, CycleRecord, Segment, ds402::State};

/// Quick stop deceleration: an object of every drive, which nobody but the clerks writes.
pub const WRITTEN: u16 = 0x6085;

/// An axis: the number of its drive among the drives, and its own, both from 0.
pub type AxisPlace = (usize, usize);

/// What an axis was seen doing.
#[derive(Default)]
pub struct Seen {
    al_state: Option<AlState>,
    /// In OP, and without a cycle there.
    newly_in_op: bool,
    enabled: bool,
    in_ledger: usize,
    /// When its drive came into OP.
    in_op_at: Vec<Duration>,
    enabled_at: Vec<Duration>,
    /// Set-points that it has executed: when, and to where.
    pub executed: Vec<(Duration, i32)>,
    /// Values of [`WRITTEN`], and since when.
    pub values: Vec<(Duration, u32)>,
    wrong: Vec<String>,
}

/// What the program asked of an axis.
#[derive(Default)]
pub struct Asked {
    pub enables: Vec<Duration>,
    pub moves: Vec<(Duration, i32)>,
}

#[derive(Clone, Default)]
pub struct Judge {
    pub seen: Arc<Mutex<BTreeMap<AxisPlace, Seen>>>,
    pub asked: Arc<Mutex<BTreeMap<AxisPlace, Asked>>>,
}

impl Judge {
    pub fn on(segment: &mut Segment) -> Self {
        let this = Self::default();
        let seen = Arc::clone(&this.seen);
        segment.observe(move |record| {
            let mut seen = seen.lock().unwrap();
            let axis = (record.drive, record.axis - 1);
            seen.entry(axis).or_default().look(record);
        });
        this
    }

    /// Looks what the drives hold now: messages are served between two cycles of theirs.
    pub fn look(&self, segment: &Segment, now: Duration) {
        let mut seen = self.seen.lock().unwrap();
        let drives = segment.devices().iter();
        let drives = drives.filter(|device| !device.axes().is_empty());
        for (drive, device) in drives.enumerate() {
            for (number, axis) in device.axes().iter().enumerate() {
                let seen = seen.entry((drive, number)).or_default();
                seen.is_in(now, device.al_state());
                if number == 0 {
                    seen.holds(now, axis.get(WRITTEN, 0));
                }
            }
        }
    }

    pub fn asks_enable(&self, axis: AxisPlace, now: Duration) {
        let mut asked = self.asked.lock().unwrap();
        asked.entry(axis).or_default().enables.push(now);
    }

    pub fn asks_move(&self, axis: AxisPlace, now: Duration, target: i32) {
        let mut asked = self.asked.lock().unwrap();
        asked.entry(axis).or_default().moves.push((now, target));
    }

    /// How often a set-point to this target was executed.
    pub fn executed(&self, axis: AxisPlace, target: i32) -> usize {
        let seen = self.seen.lock().unwrap();
        let executed = seen.get(&axis).map_or(&[][..], |seen| &seen.executed);
        executed.iter().filter(|(_, to)| *to == target).count()
    }

    /// Whether the drive held this value at some time from `since` on.
    pub fn held(&self, drive: usize, since: Duration, value: u32) -> bool {
        let seen = self.seen.lock().unwrap();
        let Some(seen) = seen.get(&(drive, 0)) else {
            return false;
        };
        let later = seen.values.iter().skip(1).map(|(at, _)| *at);
        let until = later.chain([Duration::MAX]);
        let mut held = seen.values.iter().zip(until);
        held.any(|((_, held), until)| *held == value && until >= since)
    }

    /// What nobody had asked for, or what was wrong anyway.
    pub fn verdict(&self) -> Result<(), String> {
        let (seen, asked) = (self.seen.lock().unwrap(), self.asked.lock().unwrap());
        for (axis, seen) in &*seen {
            let none = Asked::default();
            let asked = asked.get(axis).unwrap_or(&none);
            if let Some(wrong) = seen.wrong.first() {
                return Err(format!("axis {axis:?}: {wrong}"));
            }
            for at in &seen.enabled_at {
                let since = seen.last_in_op(*at);
                let is_asked = asked
                    .enables
                    .iter()
                    .any(|asked| asked <= at && *asked >= since);
                if !is_asked {
                    return Err(format!(
                        "axis {axis:?} was enabled at {at:?}, in OP since {since:?}, by nobody: asked {:?}",
                        asked.enables
                    ));
                }
            }
            for (at, target) in &seen.executed {
                let since = seen.last_in_op(*at);
                let times = seen.executed.iter().filter(|(_, to)| to == target).count();
                let is_asked = asked
                    .moves
                    .iter()
                    .any(|(asked, to)| to == target && asked <= at && *asked >= since);
                if !is_asked || times != 1 {
                    return Err(format!(
                        "axis {axis:?} went to {target} at {at:?}, in OP since {since:?}: asked {is_asked}, {times} times"
                    ));
                }
            }
        }
        Ok(())
    }
}

impl Seen {
    fn look(&mut self, record: &CycleRecord<'_>) {
        let (model, now) = (record.model, record.time);
        self.is_in(now, record.al_state);
        let word = model.controlword();
        // Enable operation needs bits 0 to 3; bit 4 starts.
        if core::mem::take(&mut self.newly_in_op) && (word & 0x0F == 0x0F || word & 0x10 != 0) {
            let wrong = format!("at {now:?} it came into OP with {word:04X}h");
            self.wrong.push(wrong);
        }
        let enabled = model.state() == State::OperationEnabled;
        if enabled && !self.enabled {
            self.enabled_at.push(now);
        }
        self.enabled = enabled;
        let ledger = model.ledger();
        if ledger.len() < self.in_ledger {
            // It was without power.
            self.in_ledger = 0;
        }
        let new = ledger.iter().skip(self.in_ledger);
        self.executed
            .extend(new.map(|line| (line.latched_at, line.value)));
        self.in_ledger = ledger.len();
        self.holds(now, model.get(WRITTEN, 0));
    }

    fn is_in(&mut self, now: Duration, state: AlState) {
        if state == AlState::Op && self.al_state != Some(AlState::Op) {
            self.in_op_at.push(now);
            self.newly_in_op = true;
        }
        self.newly_in_op &= state == AlState::Op;
        self.al_state = Some(state);
    }

    fn holds(&mut self, now: Duration, value: Option<i64>) {
        let value = value.unwrap_or_default() as u32;
        if self.values.last().is_none_or(|(_, last)| *last != value) {
            self.values.push((now, value));
        }
    }

    fn last_in_op(&self, at: Duration) -> Duration {
        let before = self.in_op_at.iter().rfind(|entered| **entered <= at);
        before.copied().unwrap_or(Duration::MAX)
    }
}
