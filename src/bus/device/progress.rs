//! How far the bring-up of a line is, for whoever shows it.
//!
//! What the program does with a report may take its time, and must not stop the cycles with it. The bus thread therefore only
//! queues what is done ([`Progress`]); the future that waits for its end reports to the program ([`Listener::report_until`]).

use std::{
    cell::Cell,
    fmt,
    future::{Future, pending},
    sync::Arc,
};

use smol::{
    channel::{Receiver, Sender},
    future::or,
};

use crate::{
    bus::{
        error::{AlState, BringUpStep},
        log::LogRecord,
        requests::Context,
    },
    coe::DriveId,
};

/// A step of a drive's bring-up that is done.
#[derive(Debug, Clone, Copy)]
#[non_exhaustive]
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
    BringUpStep::Watchdog,
    BringUpStep::State(AlState::SafeOp),
    BringUpStep::Parameters,
    BringUpStep::State(AlState::Op),
];

/// The steps of a drive that is replaced which are done before these.
const OF_A_REPLACEMENT: [BringUpStep; 2] = [BringUpStep::Restore, BringUpStep::Store];

/// A step that is done, on its way to whoever waits for the last one.
pub(in crate::bus) struct StepDone {
    drive: Arc<DriveId>,
    step: BringUpStep,
    done: usize,
    total: usize,
}

type ProgressListener = dyn Fn(&BringUpProgress<'_>) + Send + Sync;

/// Where the program wants reports of progress.
#[derive(Clone)]
pub(in crate::bus) struct Listener(Option<Arc<ProgressListener>>);

impl Listener {
    pub const NOBODY: Self = Self(None);

    pub fn new(listener: impl Fn(&BringUpProgress<'_>) + Send + Sync + 'static) -> Self {
        Self(Some(Arc::new(listener)))
    }

    /// Tells of each step, until it is over: of all that were done by then.
    pub async fn report_until<T>(
        &self,
        steps: Receiver<StepDone>,
        over: impl Future<Output = T>,
    ) -> T {
        let telling = async {
            while let Ok(step) = steps.recv().await {
                self.report(&step);
            }
            pending().await
        };
        let result = or(telling, over).await;
        while let Ok(step) = steps.try_recv() {
            self.report(&step);
        }
        result
    }

    fn report(&self, step: &StepDone) {
        if let Some(listener) = &self.0 {
            listener(&BringUpProgress {
                drive: &step.drive,
                step: step.step,
                done: step.done,
                total: step.total,
            });
        }
    }
}

impl fmt::Debug for Listener {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(if self.0.is_some() { "Some" } else { "None" })
    }
}

/// Counts the steps of all drives.
pub(in crate::bus) struct Progress {
    context: Context,
    steps: Sender<StepDone>,
    done: Cell<usize>,
    total: usize,
}

impl Progress {
    /// Counts all steps of so many devices.
    pub fn new(context: &Context, steps: Sender<StepDone>, drives: usize, ios: usize) -> Self {
        let total = drives * STEPS.len() + ios * (STEPS.len() - 1);
        Self::of_one(context, steps, total)
    }

    /// Counts the steps of a drive that is replaced.
    pub fn of_a_replacement(context: &Context, steps: Sender<StepDone>) -> Self {
        Self::of_one(context, steps, OF_A_REPLACEMENT.len() + STEPS.len())
    }

    /// Counts so many steps of one device that is brought back into OP.
    pub fn of_one(context: &Context, steps: Sender<StepDone>, total: usize) -> Self {
        Self {
            context: context.clone(),
            steps,
            done: Cell::new(0),
            total,
        }
    }

    /// A drive has done a step, which is one of these.
    pub fn step(&self, drive: &DriveId, step: BringUpStep) {
        let mut counted = STEPS.iter().chain(&OF_A_REPLACEMENT);
        debug_assert!(
            counted.any(|counted| *counted == step),
            "{step} is not counted"
        );
        let done = self.done.get() + 1;
        self.done.set(done);
        let drive = Arc::new(drive.clone());
        let total = self.total;
        let told = StepDone {
            drive: Arc::clone(&drive),
            step,
            done,
            total,
        };
        // Whoever waited may have gone away.
        let _ = self.steps.try_send(told);
        let note = LogRecord::Step {
            drive,
            step,
            done,
            total,
        };
        self.context.log.record(self.context.time.now(), note);
    }
}
