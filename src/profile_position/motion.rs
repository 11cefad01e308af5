//! A move that the drive has taken, and the one outcome that it comes to.

use core::{
    fmt,
    future::Future,
    pin::Pin,
    task::{Context, Poll},
    time::Duration,
};

use crate::axis::{AxisError, AxisErrorKind, BoxFuture, Pending};

use super::{Completion, Failure, MoveCommand};

/// How a move ended well.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Outcome {
    /// It arrived at its target and nothing followed it in motion.
    Reached {
        /// Position actual value 6064h when it was seen.
        position: i32,
    },
    /// It passed its target without stopping, into the next one.
    Passed {
        /// Position actual value 6064h when it was seen.
        position: i32,
    },
}

impl Outcome {
    /// Position actual value 6064h when it was seen.
    #[must_use]
    pub const fn position(&self) -> i32 {
        match *self {
            Self::Reached { position } | Self::Passed { position } => position,
        }
    }
}

impl fmt::Display for Outcome {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Reached { position } => write!(f, "reached {position}"),
            Self::Passed { position } => write!(f, "passed {position}"),
        }
    }
}

/// A move that the drive has acknowledged. Dropping it does not stop the motion, see
/// [`halt_on_drop`](Self::halt_on_drop).
#[must_use = "await `done()` for the outcome"]
#[derive(Debug)]
pub struct Move {
    pending: Pending,
    command: MoveCommand,
    halt_on_drop: bool,
}

impl Move {
    pub(crate) const fn new(pending: Pending, command: MoveCommand) -> Self {
        Self {
            pending,
            command,
            halt_on_drop: false,
        }
    }

    /// What was asked for.
    #[must_use]
    pub const fn command(&self) -> &MoveCommand {
        &self.command
    }

    /// Waits for the outcome, of which there is exactly one: asked again it is the same. A halt, by anyone, ends the
    /// wait with [`Failure::Halted`] when the axis stands, once for each halt: the move may go on, and so may a later
    /// wait. There is no deadline unless one is given by [`Done::within`].
    ///
    /// # Errors
    /// Of the future: the [`Failure`] of the move, with the drive's error code for a fault.
    pub fn done(&self) -> Done<'_> {
        self.wait(false)
    }

    /// As [`done`](Self::done), but waits on through halts until the move is resumed and done, or abandoned.
    ///
    /// # Errors
    /// Of the future: the [`Failure`] of the move, with the drive's error code for a fault.
    pub fn done_through_halt(&self) -> Done<'_> {
        self.wait(true)
    }

    /// The outcome, if it is there: nothing is waited for.
    #[must_use]
    pub fn outcome(&self) -> Option<Result<Outcome, Failure>> {
        self.pending
            .result()
            .map(|result| result.and_then(outcome_of))
    }

    /// Halts the axis when this is dropped before the outcome.
    pub const fn halt_on_drop(mut self) -> Self {
        self.halt_on_drop = true;
        self
    }

    fn wait(&self, through_halt: bool) -> Done<'_> {
        let result = async move {
            let completion = if through_halt {
                self.pending.done().await
            } else {
                self.pending.done_or_halted().await
            };
            let result = completion.and_then(|completion| {
                outcome_of(completion).map_err(|failure| self.error(AxisErrorKind::Failed(failure)))
            });
            self.trace(&result);
            result
        };
        Done {
            pending: &self.pending,
            result: Box::pin(result),
        }
    }

    fn error(&self, kind: AxisErrorKind) -> AxisError {
        self.pending.handles.shared.error(kind)
    }

    fn trace(&self, result: &Result<Outcome, AxisError>) {
        let identity = &self.pending.handles.shared.identity;
        let target = self.command.target;
        match result {
            Ok(outcome) => tracing::info!(
                axis = identity.axis,
                drive = %identity.drive,
                target,
                %outcome,
                "move done"
            ),
            Err(error) => tracing::warn!(
                axis = identity.axis,
                drive = %identity.drive,
                target,
                "move ended: {}",
                error.kind
            ),
        }
    }
}

impl Drop for Move {
    fn drop(&mut self) {
        if self.halt_on_drop && self.pending.result().is_none() {
            self.pending
                .handles
                .shared
                .request_stop(crate::axis::StopRequest::HALT);
        }
    }
}

/// A move has no other way to end well.
const fn outcome_of(completion: Completion) -> Result<Outcome, Failure> {
    match completion {
        Completion::Reached { position } => Ok(Outcome::Reached { position }),
        Completion::Passed { position } => Ok(Outcome::Passed { position }),
        Completion::Homed { .. } | Completion::Stopped { .. } | Completion::Done => {
            Err(Failure::QUICK_STOPPED)
        }
    }
}

/// The wait for the outcome of a [`Move`].
#[must_use = "futures do nothing unless awaited"]
pub struct Done<'a> {
    pending: &'a Pending,
    result: BoxFuture<'a, Result<Outcome, AxisError>>,
}

impl<'a> Done<'a> {
    /// Waits no longer than this, by the network's time, from when it is first polled; then [`AxisErrorKind::Late`]. That stops
    /// nothing: the move goes on, and can be waited for again.
    pub fn within(self, deadline: Duration) -> Self {
        let pending = self.pending;
        let late = pending.handles.late(deadline);
        Done {
            pending,
            result: Box::pin(smol::future::or(self.result, late)),
        }
    }
}

impl Future for Done<'_> {
    type Output = Result<Outcome, AxisError>;

    fn poll(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<Self::Output> {
        self.result.as_mut().poll(cx)
    }
}

impl fmt::Debug for Done<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Done").finish_non_exhaustive()
    }
}
