//! What happens to axes, for the log: also what no handle waits for. Noted in the cycle, written in the gap behind it.
//!
//! A cycle in which nothing happens costs a comparison for each axis. The lines are written on the bus thread: a
//! subscriber that blocks (a paused terminal, a full pipe) stops the cycles, and the drives stop by their watchdog. Programs
//! that log where that can happen use a subscriber that hands its lines to a thread of its own.

use super::black_box::Trouble;
use crate::{
    axis::{AxisIdentity, Snapshot, StopRequest},
    ds402::State,
};

/// What is kept between two gaps.
const ROOM: usize = 64;

/// Notes of what happened to the axes, in the order in which it happened.
pub(super) struct Journal {
    axes: Vec<AxisIdentity>,
    seen: Vec<Option<Seen>>,
    notes: Vec<Note>,
    /// For how many notes there was no room.
    missed: u64,
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

#[derive(Debug, Clone, Copy)]
enum Note {
    Axis {
        index: usize,
        before: Option<Seen>,
        snapshot: Snapshot,
    },
    StopOfAll(StopRequest),
    Unfed,
}

impl Journal {
    pub(super) fn new(axes: Vec<AxisIdentity>) -> Self {
        Self {
            seen: vec![None; axes.len()],
            axes,
            notes: Vec::with_capacity(ROOM),
            missed: 0,
            unfed: false,
            troubles: Vec::with_capacity(ROOM),
        }
    }

    /// Notes what is new in this axis' snapshot.
    pub(super) fn look(&mut self, index: usize, snapshot: &Snapshot) {
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
                && self.troubles.len() < ROOM
            {
                self.troubles.push((index, trouble));
            }
            self.note(Note::Axis {
                index,
                before,
                snapshot: *snapshot,
            });
        }
    }

    /// Notes that the program stopped all axes.
    pub(super) fn stop_of_all(&mut self, stop: StopRequest) {
        if !stop.is_empty() {
            self.note(Note::StopOfAll(stop));
        }
    }

    /// Notes that the program no longer says that it is alive, once each time.
    pub(super) fn liveness(&mut self, expired: bool) {
        if expired && !self.unfed {
            self.note(Note::Unfed);
        }
        self.unfed = expired;
    }

    /// What came upon which axis since the last time, in that order.
    pub(super) fn take_troubles(&mut self) -> impl Iterator<Item = (usize, Trouble)> + '_ {
        self.troubles.drain(..)
    }

    /// Writes the notes to the log. Not while frames are on their way: a subscriber may take its time.
    pub(super) fn write(&mut self) {
        for note in self.notes.drain(..) {
            match note {
                Note::Axis {
                    index,
                    before,
                    snapshot,
                } => {
                    if let Some(axis) = self.axes.get(index) {
                        write_change(axis, before, &snapshot);
                    }
                }
                Note::StopOfAll(stop) => tracing::warn!(?stop, "all axes are stopped"),
                Note::Unfed => {
                    tracing::warn!("the program no longer feeds its liveness: all axes are halted");
                }
            }
        }
        if self.missed > 0 {
            tracing::warn!(self.missed, "changes of axes were not logged");
            self.missed = 0;
        }
    }

    fn note(&mut self, note: Note) {
        if self.notes.len() < ROOM {
            self.notes.push(note);
        } else {
            self.missed += 1;
        }
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

/// An event for each thing that has changed.
fn write_change(identity: &AxisIdentity, before: Option<Seen>, snapshot: &Snapshot) {
    let AxisIdentity { axis, drive } = identity;
    let from = before.map(|seen| seen.state);
    let to = snapshot.state;
    // As a macro, because the level of an event is a constant.
    macro_rules! event {
        ($level:ident, $text:literal) => {
            tracing::$level!(
                axis,
                %drive,
                from = from.map(tracing::field::debug),
                to = ?to,
                statusword = %format_args!("{:04X}h", snapshot.statusword.bits()),
                controlword = %format_args!("{:04X}h", snapshot.controlword.bits()),
                position = snapshot.position,
                $text
            )
        };
    }
    if before.map_or(snapshot.lost, |seen| seen.lost != snapshot.lost) {
        if snapshot.lost {
            event!(warn, "counts as lost");
        } else {
            event!(info, "is there again");
        }
    }
    if from != Some(to) {
        if matches!(to, State::Fault | State::FaultReactionActive) {
            event!(error, "fault");
        } else {
            event!(info, "state changed");
        }
    }
    if before.is_some_and(|seen| seen.halted != snapshot.halted) {
        if snapshot.halted {
            event!(info, "halted");
        } else {
            event!(info, "no longer halted");
        }
    }
}
