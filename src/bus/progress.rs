//! How far the bring-up of a line is, for whoever shows it.

use std::{cell::Cell, fmt, rc::Rc, sync::Arc};

use super::{
    AlState, BringUpStep,
    log::{Log, Note},
    time::Time,
};
use crate::coe::DriveId;

/// A step of a drive's bring-up that is done.
#[derive(Debug, Clone, Copy)]
pub struct BringUpProgress<'a> {
    /// The drive.
    pub drive: &'a DriveId,
    /// What has been done.
    pub step: BringUpStep,
    /// Steps that are done, of all drives.
    pub done: usize,
    /// Steps of all drives.
    pub total: usize,
}

/// The steps that are reported, of each drive. Of a device that is none there are no parameters to read.
const STEPS: [BringUpStep; 7] = [
    BringUpStep::Identity,
    BringUpStep::StartUpList,
    BringUpStep::Mapping,
    BringUpStep::Parameters,
    BringUpStep::Watchdog,
    BringUpStep::State(AlState::SafeOp),
    BringUpStep::State(AlState::Op),
];

type Told = dyn Fn(&BringUpProgress<'_>) + Send + Sync;

/// Whom the program wants to be told.
#[derive(Clone)]
pub(super) struct Listener(Option<Arc<Told>>);

impl Listener {
    pub(super) const NOBODY: Self = Self(None);

    pub(super) fn new(listener: impl Fn(&BringUpProgress<'_>) + Send + Sync + 'static) -> Self {
        Self(Some(Arc::new(listener)))
    }
}

impl fmt::Debug for Listener {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(if self.0.is_some() { "Some" } else { "None" })
    }
}

/// Counts the steps of all drives.
pub(super) struct Progress {
    listener: Listener,
    log: Log,
    time: Rc<Time>,
    done: Cell<usize>,
    total: usize,
}

impl Progress {
    pub(super) fn new(
        listener: Listener,
        log: Log,
        time: Rc<Time>,
        drives: usize,
        ios: usize,
    ) -> Self {
        Self {
            listener,
            log,
            time,
            done: Cell::new(0),
            total: drives * STEPS.len() + ios * (STEPS.len() - 1),
        }
    }

    /// Counts so many steps of one device that is led back.
    pub(super) const fn of_one(listener: Listener, log: Log, time: Rc<Time>, total: usize) -> Self {
        Self {
            listener,
            log,
            time,
            done: Cell::new(0),
            total,
        }
    }

    /// A drive has done a step, which is one of [`STEPS`].
    pub(super) fn step(&self, drive: &DriveId, step: BringUpStep) {
        debug_assert!(STEPS.contains(&step), "{step} is not counted");
        let done = self.done.get() + 1;
        self.done.set(done);
        let note = Note::Step {
            drive: Arc::new(drive.clone()),
            step,
            done,
            total: self.total,
        };
        self.log.note(self.time.now(), note);
        if let Some(listener) = &self.listener.0 {
            listener(&BringUpProgress {
                drive,
                step,
                done,
                total: self.total,
            });
        }
    }
}
