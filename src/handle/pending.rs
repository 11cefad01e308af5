//! One command under way, as its future holds it.

use core::sync::atomic::{AtomicU32, Ordering};
use std::sync::Arc;

use crate::axis::{Command, CommandId, Completion, Delivery, Failure};

use super::{
    AxisError, AxisErrorKind, axis::Handles, commands::Ticket, error::HandleUnit, stops::LastStop,
};

/// What becomes of a command when nobody waits for it any more.
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
    pub id: CommandId,
    ticket: Arc<Ticket>,
    /// Of the handle.
    pub unit: HandleUnit,
    on_drop: OnDrop,
    halts_seen: AtomicU32,
}

impl Pending {
    pub fn submit(
        handles: Arc<Handles>,
        unit: HandleUnit,
        command: Command,
    ) -> Result<Self, AxisError> {
        let ticket = handles.shared.submit(command);
        Self::of(handles, unit, ticket, OnDrop::GoOn)
    }

    /// What starts a motion and was asked for when this was the last stop.
    pub fn submit_motion(
        handles: Arc<Handles>,
        unit: HandleUnit,
        command: Command,
        asked: LastStop,
    ) -> Result<Self, AxisError> {
        let ticket = handles.shared.submit_asked(command, asked);
        Self::of(handles, unit, ticket, OnDrop::Withdraw)
    }

    fn of(
        handles: Arc<Handles>,
        unit: HandleUnit,
        ticket: Result<Arc<Ticket>, AxisErrorKind>,
        on_drop: OnDrop,
    ) -> Result<Self, AxisError> {
        let ticket = ticket.map_err(|kind| handles.shared.error(kind))?;
        Ok(Self {
            id: ticket.id,
            ticket,
            unit,
            on_drop,
            halts_seen: AtomicU32::new(0),
            handles,
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

    pub fn ticket(&self) -> Arc<Ticket> {
        Arc::clone(&self.ticket)
    }

    /// The result, once it is there.
    pub fn result(&self) -> Option<Result<Completion, Failure>> {
        self.handles.shared.result(&self.ticket)
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
        let result = self
            .wait(|| {
                self.result().or_else(|| {
                    let halts = self.handles.shared.halts(self.id);
                    self.halts_seen.store(halts, Ordering::Release);
                    let delivery = if self.handles.shared.is_accepted(&self.ticket) {
                        Delivery::Accepted
                    } else {
                        Delivery::Unknown
                    };
                    (seen != halts).then_some(Err(Failure::Halted { delivery }))
                })
            })
            .await;
        self.judge(result).await
    }

    /// Waits for the drive's acknowledge of a move's set-point. From then on dropping this withdraws nothing.
    pub async fn accepted(&mut self) -> Result<(), AxisError> {
        let result = self
            .wait(|| {
                if self.handles.shared.is_accepted(&self.ticket) {
                    return Some(Ok(()));
                }
                self.result().map(|result| result.map(|_| ()))
            })
            .await;
        if self.on_drop == OnDrop::Withdraw {
            self.on_drop = OnDrop::GoOn;
        }
        match result {
            Ok(()) => Ok(()),
            Err(failure) => Err(self.fail(failure).await),
        }
    }

    async fn fail(&self, failure: Failure) -> AxisError {
        self.handles.fail(failure).await.in_unit(self.unit)
    }

    /// An error of this command's handle.
    pub fn error(&self, kind: AxisErrorKind) -> AxisError {
        self.handles.shared.error(kind).in_unit(self.unit)
    }

    async fn wait<T>(&self, ready: impl FnMut() -> Option<T>) -> T {
        self.handles.shared.until(self.id, ready).await
    }

    async fn judge(&self, result: Result<Completion, Failure>) -> Result<Completion, AxisError> {
        match result {
            Ok(completion) => Ok(completion),
            Err(failure) => Err(self.fail(failure).await),
        }
    }
}

impl Drop for Pending {
    fn drop(&mut self) {
        let shared = &self.handles.shared;
        if self.on_drop != OnDrop::GoOn && !shared.is_done(self.id) {
            self.handles.withdraw(self.id, self.on_drop == OnDrop::End);
        }
        shared.leave(self.id);
    }
}

impl Handles {
    /// The error for a failure. A fault whose code is not in the process data is asked for its code, so that the error
    /// has it.
    pub async fn fail(&self, failure: Failure) -> AxisError {
        let failure = match failure {
            Failure::Fault { code: None } => Failure::Fault {
                code: self.read_error_code().await,
            },
            failure => failure,
        };
        if let Failure::Fault { code } = failure {
            let status = self.shared.snapshot();
            // The fault itself is logged once, by the owner of the cycle.
            tracing::debug!(
                target: super::LOG,
                axis = self.shared.identity.axis,
                drive = %self.shared.identity.drive,
                code = code.map(tracing::field::display),
                statusword = %status.statusword,
                controlword = %status.controlword,
                "{failure}"
            );
        }
        self.shared.error(AxisErrorKind::Failed(failure))
    }
}
