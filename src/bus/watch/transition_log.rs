//! What happens to axes, also what no handle waits for: for the log, and for the black boxes of those that have trouble.
//!
//! A cycle in which nothing happens costs a comparison for each axis; what has happened is noted and written elsewhere
//! ([`Log`]).

use std::{sync::Arc, time::Duration};

use crate::{
    axis::{AxisIdentity, Snapshot, StopRequest},
    bus::{
        cycle::black_box::AxisIncident,
        log::{AxisChange, AxisRecord, Log, LogRecord},
    },
    ds402::State,
};

/// Troubles that are kept until somebody asks, for each axis: all of a line may come in one cycle.
const INCIDENTS_OF_AN_AXIS: usize = 2;

/// Notes what happens to the axes, in the order in which it happens.
pub(in crate::bus) struct TransitionLog {
    axes: Vec<Arc<AxisIdentity>>,
    seen: Vec<Option<ShownState>>,
    log: Log,
    unfed: bool,
    /// What came upon which axis since somebody asked.
    incidents: Vec<(usize, AxisIncident)>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct ShownState {
    state: State,
    halted: bool,
    lost: bool,
}

impl TransitionLog {
    pub(in crate::bus) fn new(axes: impl Iterator<Item = AxisIdentity>, log: Log) -> Self {
        let axes: Vec<_> = axes.map(Arc::new).collect();
        Self {
            seen: vec![None; axes.len()],
            incidents: Vec::with_capacity(INCIDENTS_OF_AN_AXIS * axes.len()),
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
        let new = ShownState {
            state: snapshot.state,
            halted: snapshot.halted,
            lost: snapshot.lost,
        };
        let before = seen.replace(new);
        if before != Some(new) {
            let incident = before.and_then(|before| new.incident_since(before));
            if let Some(incident) = incident
                && self.incidents.len() < self.incidents.capacity()
            {
                self.incidents.push((index, incident));
            }
            if let Some(axis) = self.axes.get(index) {
                note_changes(&self.log, now, axis, before, snapshot);
            }
        }
    }

    /// Notes that the program stopped all axes.
    pub(in crate::bus) fn stop_of_all(&self, now: Duration, stop: StopRequest) {
        if !stop.is_empty() {
            self.log.record(now, LogRecord::StopOfAll(stop));
        }
    }

    /// Notes that the program no longer says that it is alive, once each time.
    pub(in crate::bus) fn liveness(&mut self, now: Duration, expired: bool) {
        if expired && !self.unfed {
            self.log.record(now, LogRecord::Unfed);
        }
        self.unfed = expired;
    }

    /// What came upon which axis since the last time, in that order.
    pub(in crate::bus) fn take_incidents(
        &mut self,
    ) -> impl Iterator<Item = (usize, AxisIncident)> + '_ {
        self.incidents.drain(..)
    }
}

impl ShownState {
    fn incident_since(self, before: Self) -> Option<AxisIncident> {
        if self.lost && !before.lost {
            Some(AxisIncident::Lost)
        } else if self.state.is_fault() && !before.state.is_fault() {
            Some(AxisIncident::Fault)
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
    before: Option<ShownState>,
    snapshot: &Snapshot,
) {
    let note = |change| {
        let note = AxisRecord {
            axis: Arc::clone(axis),
            change,
            from: before.map(|seen| seen.state),
            to: snapshot.state,
            statusword: snapshot.statusword,
            controlword: snapshot.controlword,
            position: snapshot.position,
        };
        log.record(now, LogRecord::Axis(note));
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
