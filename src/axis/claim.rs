//! Who writes the parameters of the next motion by SDO: one at a time, and never a lock. A future that is kept and not polled any
//! more holds others up for a while and no longer.

use core::{
    future::poll_fn,
    task::{Poll, Waker},
    time::Duration,
};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use super::{
    AxisError, AxisErrorKind, Failure, handle::Handles, pending::Pending, tickets::Ticket,
};
use crate::profile_position::WrittenParameters;

/// So long a move waits for one that writes its parameters, and gets no further.
const PATIENCE: Duration = Duration::from_secs(1);

/// Who is at it, and what motions have written.
#[derive(Debug, Default)]
pub(crate) struct Claims(Mutex<State>);

#[derive(Debug, Default)]
struct State {
    holder: Holder,
    /// How many claims there were.
    count: u64,
    /// How many writes of them were confirmed.
    steps: u64,
    written: WrittenParameters,
    waiting: Vec<Waker>,
}

#[derive(Debug, Clone, Default)]
enum Holder {
    #[default]
    Nobody,
    /// The claim with this number: its writes go on as its future is polled.
    Writing(u64),
    /// The motion is with the bus thread, until the drive has taken it.
    Sent(Arc<Ticket>),
}

impl PartialEq for Holder {
    fn eq(&self, other: &Self) -> bool {
        match (self, other) {
            (Self::Nobody, Self::Nobody) => true,
            (Self::Writing(one), Self::Writing(other)) => one == other,
            (Self::Sent(one), Self::Sent(other)) => Arc::ptr_eq(one, other),
            _ => false,
        }
    }
}

/// The parameters are this motion's.
#[derive(Debug)]
pub(crate) struct Claim<'a> {
    handles: &'a Handles,
    number: u64,
    pub(crate) written: WrittenParameters,
}

impl Claims {
    fn state(&self) -> MutexGuard<'_, State> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Handles {
    /// Claims the parameters for a motion that has no other beside it.
    ///
    /// # Errors
    /// [`Failure::Busy`] where another is at it.
    pub(crate) fn claim_now(&self) -> Result<Claim<'_>, AxisError> {
        let mut state = self.claims.state();
        self.take(&mut state).ok_or_else(|| self.busy())
    }

    /// Claims the parameters for one of several moves: it waits for those before.
    ///
    /// # Errors
    /// [`Failure::Busy`] where one before gets no further, as one does whose future is kept and not polled.
    pub(crate) async fn claim(&self) -> Result<Claim<'_>, AxisError> {
        let groups = &self.shared.setup.groups;
        loop {
            let (seen, steps) = {
                let mut state = self.claims.state();
                if let Some(claim) = self.take(&mut state) {
                    return Ok(claim);
                }
                (state.holder.clone(), state.steps)
            };
            let changed = poll_fn(|cx| {
                let mut state = self.claims.state();
                if state.holder != seen {
                    return Poll::Ready(());
                }
                let waiting = &mut state.waiting;
                if !waiting.iter().any(|waker| waker.will_wake(cx.waker())) {
                    waiting.push(cx.waker().clone());
                }
                Poll::Pending
            });
            // The drive takes what was sent without a word to those who wait here.
            let taken = self.until_taken(&seen);
            let late = groups.sleep_until(groups.now().saturating_add(PATIENCE));
            smol::future::or(smol::future::or(changed, taken), late).await;
            let state = self.claims.state();
            let is_late = matches!(seen, Holder::Writing(_)) && state.holder == seen;
            if is_late && state.steps == steps {
                return Err(self.busy());
            }
        }
    }

    /// Ready when the motion that was sent has been taken; never where none was.
    async fn until_taken(&self, holder: &Holder) {
        match holder {
            Holder::Sent(ticket) => {
                let is_over = || self.shared.is_over(ticket).then_some(());
                self.shared.until(ticket.id, is_over).await;
            }
            _ => core::future::pending().await,
        }
    }

    fn take(&self, state: &mut State) -> Option<Claim<'_>> {
        let is_free = match &state.holder {
            Holder::Nobody => true,
            Holder::Writing(_) => false,
            Holder::Sent(ticket) => self.shared.is_over(ticket),
        };
        is_free.then(|| {
            state.count += 1;
            state.holder = Holder::Writing(state.count);
            Claim {
                handles: self,
                number: state.count,
                written: core::mem::take(&mut state.written),
            }
        })
    }

    fn busy(&self) -> AxisError {
        self.shared.error(AxisErrorKind::Failed(Failure::Busy))
    }
}

impl Claim<'_> {
    /// Another write was confirmed.
    pub(crate) fn step(&self) {
        self.handles.claims.state().steps += 1;
    }

    /// The motion was asked for: until the drive has taken it no other's parameters come in between.
    pub(crate) fn sent(self, pending: &Pending) {
        // Dropped then, it wakes those who wait: for the drive, from now on.
        self.handles.claims.state().holder = Holder::Sent(pending.ticket());
    }
}

impl Drop for Claim<'_> {
    fn drop(&mut self) {
        let waiting = {
            let mut state = self.handles.claims.state();
            state.written = core::mem::take(&mut self.written);
            if matches!(state.holder, Holder::Writing(number) if number == self.number) {
                state.holder = Holder::Nobody;
            }
            core::mem::take(&mut state.waiting)
        };
        waiting.into_iter().for_each(Waker::wake);
    }
}
