//! A request as a handle holds it, and the futures that wait for it.

use core::sync::atomic::{AtomicU32, Ordering};
use std::sync::Arc;

use crate::{
    Failure,
    axis::{Command, Completion},
};

use super::{
    AxisError, AxisErrorKind,
    axis::Handles,
    error::{EndedByHalt, HandleUnit},
    request::AxisRequest,
    stops::LastStop,
};

/// What becomes of a request when nobody waits for it any more.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum OnDrop {
    GoOn,
    /// So far as its drive has seen nothing of it.
    Withdraw,
    /// Withdrawn or, where its drive has seen something of it, stopped.
    End,
}

/// One command under way. Dropped before its drive has seen anything of it, a motion is withdrawn; other commands go on.
#[derive(Debug)]
pub(super) struct Pending {
    pub handles: Arc<Handles>,
    pub request: Arc<AxisRequest>,
    /// Of the handle.
    pub unit: HandleUnit,
    on_drop: OnDrop,
    halts_seen: AtomicU32,
}

impl Pending {
    /// A motion that was asked for before the last stop fails.
    pub fn submit(
        handles: Arc<Handles>,
        unit: HandleUnit,
        command: Command,
        asked: LastStop,
    ) -> Result<Self, AxisError> {
        let request = handles.shared.submit(command, asked);
        let request = request.map_err(|kind| handles.shared.error(kind))?;
        let on_drop = match command {
            Command::Move(command) if command.set_point.halt_on_drop => OnDrop::End,
            _ if request.is_motion() => OnDrop::Withdraw,
            _ => OnDrop::GoOn,
        };
        Ok(Self {
            handles,
            request,
            unit,
            on_drop,
            halts_seen: AtomicU32::new(0),
        })
    }

    /// Dropped before its end, the change of mode is given up.
    pub const fn withdraw_on_drop(mut self) -> Self {
        self.on_drop = OnDrop::Withdraw;
        self
    }

    /// Dropped before its end, the homing is stopped.
    pub const fn end_on_drop(&mut self) {
        self.on_drop = OnDrop::End;
    }

    /// Gives it up now, so far as it was not sent: it then fails as [`Failure::Withdrawn`]. From then on dropping this does nothing more.
    pub fn withdraw(&mut self) {
        self.on_drop = OnDrop::GoOn;
        self.handles.give_up(&self.request, false);
    }

    /// The result, once it is there.
    pub fn result(&self) -> Option<Result<Completion, Failure>> {
        self.handles.shared.result(&self.request)
    }

    /// Waits for the result.
    pub async fn done(&self) -> Result<Completion, AxisError> {
        let result = self.wait(|| self.result()).await;
        self.judge(result).await
    }

    /// Waits for the result, or for the axis standing halted, each halt once.
    pub async fn done_or_halted(&self) -> Result<Completion, AxisError> {
        // Waits that are under way at the same time all hear of the same halt.
        let seen = self.halts_seen.load(Ordering::Acquire);
        let halted = || {
            let halts = self.request.halts.load(Ordering::Acquire);
            self.halts_seen.store(halts, Ordering::Release);
            let delivery = self.request.delivery();
            (seen != halts).then_some(Err(Failure::Halted { delivery }))
        };
        let result = self.wait(|| self.result().or_else(halted)).await;
        self.judge(result).await
    }

    /// Waits for the drive's acknowledge of a move's set-point. From then on dropping this withdraws nothing.
    pub async fn accepted(&mut self) -> Result<(), AxisError> {
        let accepted = || self.request.is_accepted().then_some(Ok(()));
        let ended = || self.result().map(|result| result.map(drop));
        let result = self.wait(|| accepted().or_else(ended)).await;
        if self.on_drop == OnDrop::Withdraw {
            self.on_drop = OnDrop::GoOn;
        }
        self.judge(result).await
    }

    async fn wait<T>(&self, ready: impl FnMut() -> Option<T>) -> T {
        self.handles.shared.until(&self.request, ready).await
    }

    async fn judge<T>(&self, result: Result<T, Failure>) -> Result<T, AxisError> {
        match result {
            Ok(value) => Ok(value),
            Err(failure) => Err(self.of_this(self.handles.fail(failure).await)),
        }
    }

    /// An error of this command's handle.
    pub fn error(&self, kind: AxisErrorKind) -> AxisError {
        self.of_this(self.handles.shared.error(kind))
    }

    fn of_this(&self, error: AxisError) -> AxisError {
        let motion = EndedByHalt::of(&self.request.command);
        error.in_unit(self.unit).of_motion(motion)
    }
}

impl Drop for Pending {
    fn drop(&mut self) {
        if self.on_drop != OnDrop::GoOn && !self.request.is_done() {
            let ends = self.on_drop == OnDrop::End;
            self.handles.give_up(&self.request, ends);
        }
        self.request.leave();
    }
}
