//! What happens to axes, also what no handle waits for: for the log, and for the black boxes of those that have trouble.
//!
//! A cycle in which nothing happens costs a comparison for each axis; what has happened is noted and written elsewhere
//! ([`Log`]).

use std::{sync::Arc, time::Duration};

use crate::{
    axis::{AxisIdentity, Snapshot, StopRequest},
    bus::{
        cycle::black_box::Trouble,
        log::{AxisChange, AxisNote, Log, Note},
    },
    ds402::State,
};

/// Troubles that are kept until somebody asks, for each axis: all of a line may come in one cycle.
const TROUBLES_OF_AN_AXIS: usize = 2;

/// Notes what happens to the axes, in the order in which it happens.
pub(in crate::bus) struct Journal {
    axes: Vec<Arc<AxisIdentity>>,
    seen: Vec<Option<Seen>>,
    log: Log,
    unfed: bool,
    /// What came upon which axis since somebody asked.
    troubles: Vec<(usize, Trouble)>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Seen {
    state: State,
    halted: bool,
    lost: bool,
}

impl Journal {
    pub(in crate::bus) fn new(axes: impl Iterator<Item = AxisIdentity>, log: Log) -> Self {
        let axes: Vec<_> = axes.map(Arc::new).collect();
        Self {
            seen: vec![None; axes.len()],
            troubles: Vec::with_capacity(TROUBLES_OF_AN_AXIS * axes.len()),
            axes,
            log,
            unfed: false,
        }
    }

    /// Notes what is new in this axis' snapshot.
    pub(in crate::bus) fn look(&mut self, now: Duration, index: usize, snapshot: &Snapshot) {
        let Some(seen) = self.seen.get_mut(index) else {
            return;
        };
        let new = Seen {
            state: snapshot.state,
            halted: snapshot.halted,
            lost: snapshot.lost,
        };
        let before = seen.replace(new);
        if before != Some(new) {
            let trouble = before.and_then(|before| new.trouble_since(before));
            if let Some(trouble) = trouble
                && self.troubles.len() < self.troubles.capacity()
            {
                self.troubles.push((index, trouble));
            }
            if let Some(axis) = self.axes.get(index) {
                note_changes(&self.log, now, axis, before, snapshot);
            }
        }
    }

    /// Notes that the program stopped all axes.
    pub(in crate::bus) fn stop_of_all(&self, now: Duration, stop: StopRequest) {
        if !stop.is_empty() {
            self.log.note(now, Note::StopOfAll(stop));
        }
    }

    /// Notes that the program no longer says that it is alive, once each time.
    pub(in crate::bus) fn liveness(&mut self, now: Duration, expired: bool) {
        if expired && !self.unfed {
            self.log.note(now, Note::Unfed);
        }
        self.unfed = expired;
    }

    /// What came upon which axis since the last time, in that order.
    pub(in crate::bus) fn take_troubles(&mut self) -> impl Iterator<Item = (usize, Trouble)> + '_ {
        self.troubles.drain(..)
    }
}

impl Seen {
    fn trouble_since(self, before: Self) -> Option<Trouble> {
        if self.lost && !before.lost {
            Some(Trouble::Lost)
        } else if self.state.is_fault() && !before.state.is_fault() {
            Some(Trouble::Fault)
        } else {
            None
        }
    }
}

/// A note for each thing that has changed.
fn note_changes(
    log: &Log,
    now: Duration,
    axis: &Arc<AxisIdentity>,
    before: Option<Seen>,
    snapshot: &Snapshot,
) {
    let note = |change| {
        let note = AxisNote {
            axis: Arc::clone(axis),
            change,
            from: before.map(|seen| seen.state),
            to: snapshot.state,
            statusword: snapshot.statusword,
            controlword: snapshot.controlword,
            position: snapshot.position,
        };
        log.note(now, Note::Axis(note));
    };
    if before.map_or(snapshot.lost, |seen| seen.lost != snapshot.lost) {
        note(if snapshot.lost {
            AxisChange::Lost
        } else {
            AxisChange::Back
        });
    }
    if before.map(|seen| seen.state) != Some(snapshot.state) {
        note(match snapshot.state {
            State::Fault | State::FaultReactionActive => AxisChange::Fault,
            _ => AxisChange::State,
        });
    }
    if before.is_some_and(|seen| seen.halted != snapshot.halted) {
        note(if snapshot.halted {
            AxisChange::Halted
        } else {
            AxisChange::Resumed
        });
    }
}
