//! Who writes the parameters of the next motion by SDO: one at a time, and never a lock. A future that is kept and not polled any
//! more holds others up for a while and no longer.

use core::{
    future::poll_fn,
    task::{Poll, Waker},
    time::Duration,
};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crate::{
    Failure,
    axis::{AxisFields, Delivery},
    coe::{Number, Object, ObjectAddress, Writable, obj},
    profile_position::Parameters,
};

use super::{AxisError, AxisErrorKind, axis::Handles, pending::Pending, request::AxisRequest};

/// So long a move waits for one that writes its parameters, and gets no further.
const PATIENCE: Duration = Duration::from_secs(1);

/// Who is at it, and what motions have written.
#[derive(Debug, Default)]
pub(super) struct Claims(Mutex<State>);

#[derive(Debug, Default)]
struct State {
    /// In the order in which they began.
    holders: Vec<Holder>,
    /// How many claims there were.
    count: u64,
    /// How many writes of them were confirmed.
    steps: u64,
    written: WrittenParameters,
    /// The start of the axis that this is of.
    start: u64,
    waiting: Vec<Waker>,
}

/// A motion that depends on what the drive's parameters are.
#[derive(Debug, Clone)]
struct Holder {
    number: u64,
    /// Whether it changes them: then no other may get ready beside it.
    writes: bool,
    /// None while its future gets it ready. Then it is with the bus thread, until the drive has taken it.
    sent: Option<Arc<AxisRequest>>,
}

impl PartialEq for Holder {
    fn eq(&self, other: &Self) -> bool {
        self.number == other.number && self.sent.is_some() == other.sent.is_some()
    }
}

/// The parameters are this motion's, or they are left as they are for it.
#[derive(Debug)]
pub(super) struct Claim<'a> {
    handles: &'a Handles,
    number: u64,
    start: u64,
    /// None where it is not to change them.
    pub written: Option<WrittenParameters>,
}

impl Claims {
    fn state(&self) -> MutexGuard<'_, State> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Another write was confirmed.
    fn step(&self) {
        self.state().steps += 1;
    }
}

impl State {
    /// A drive that has been brought up again holds what it held at the first start, for all that is read then.
    fn begin(&mut self, start: u64) {
        if self.start != start {
            self.start = start;
            self.written.keep_unread();
        }
    }
}

impl Handles {
    /// What is known of the drive's parameters.
    fn claims_now(&self) -> MutexGuard<'_, State> {
        let mut state = self.claims.state();
        state.begin(self.shared.notes.starts());
        state
    }

    /// Whether this has anything written to the drive, as far as is known: one that writes may have begun.
    pub fn have_to_write(&self, by_sdo: &BySdo) -> bool {
        by_sdo.is_needed(&self.claims_now().written)
    }

    /// Claims the parameters for a motion that has no other beside it.
    ///
    /// # Errors
    /// [`Failure::Busy`] where another is at it.
    pub fn claim_now(&self) -> Result<Claim<'_>, AxisError> {
        let mut state = self.claims_now();
        self.take(&mut state, true).map_err(|_| self.busy())
    }

    /// Claims the parameters for one of several moves, which writes this: it waits for those before, as long as one of the two changes
    /// something.
    ///
    /// # Errors
    /// [`Failure::Busy`] where one before gets no further, as one does whose future is kept and not polled. [`AxisErrorKind::Closed`] when
    /// the network ends meanwhile.
    pub async fn claim(&self, by_sdo: &BySdo) -> Result<Claim<'_>, AxisError> {
        let signals = &self.shared.setup.groups.signals;
        loop {
            let (seen, steps) = {
                let mut state = self.claims_now();
                let writes = by_sdo.is_needed(&state.written);
                match self.take(&mut state, writes) {
                    Ok(claim) => return Ok(claim),
                    Err(holder) => (holder, state.steps),
                }
            };
            let changed = poll_fn(|cx| {
                let mut state = self.claims.state();
                if !state.holders.contains(&seen) {
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
            let late = signals.sleep_until(signals.now().saturating_add(PATIENCE));
            let closed = self.shared.until_closed();
            let next = smol::future::or(smol::future::or(changed, taken), late);
            smol::future::or(next, closed).await;
            if self.shared.is_closed() {
                return Err(self.shared.error(AxisErrorKind::Closed));
            }
            let state = self.claims.state();
            let is_late = seen.sent.is_none() && state.holders.contains(&seen);
            if is_late && state.steps == steps {
                return Err(self.busy());
            }
        }
    }

    /// Ready when the motion that was sent has been taken; never where none was.
    async fn until_taken(&self, holder: &Holder) {
        match &holder.sent {
            Some(request) => {
                let is_over = || self.is_over(request).then_some(());
                self.shared.until(request, is_over).await;
            }
            None => core::future::pending().await,
        }
    }

    /// Whether nobody's parameters matter to this motion any more.
    fn is_over(&self, request: &AxisRequest) -> bool {
        request.is_over() || self.shared.is_closed()
    }

    /// A claim, or the first of those that are in its way.
    fn take(&self, state: &mut State, writes: bool) -> Result<Claim<'_>, Holder> {
        let is_over = |sent: &Arc<AxisRequest>| self.is_over(sent);
        state
            .holders
            .retain(|holder| !holder.sent.as_ref().is_some_and(is_over));
        // One that changes nothing goes beside those that change nothing any more.
        let blocks = |holder: &&Holder| writes || holder.writes && holder.sent.is_none();
        if let Some(holder) = state.holders.iter().find(blocks) {
            return Err(holder.clone());
        }
        state.count += 1;
        let number = state.count;
        state.holders.push(Holder {
            number,
            writes,
            sent: None,
        });
        Ok(Claim {
            handles: self,
            number,
            start: state.start,
            written: writes.then(|| core::mem::take(&mut state.written)),
        })
    }

    /// Nothing more is written for a motion that was asked for before the drive was brought up again: it is not sent either.
    fn is_of(&self, start: u64) -> Result<(), AxisError> {
        if start == self.shared.notes.starts() {
            return Ok(());
        }
        let delivery = Delivery::NotSent;
        let failure = Failure::BusLost { delivery };
        Err(self.shared.error(AxisErrorKind::Failed(failure)))
    }

    fn busy(&self) -> AxisError {
        self.shared.error(AxisErrorKind::Failed(Failure::Busy))
    }
}

impl Claim<'_> {
    /// The motion was asked for: until the drive has taken it no other's parameters come in between.
    pub fn sent(mut self, pending: &Pending) {
        // Dropped then, it wakes those who wait: for the drive, from now on.
        let mut state = self.handles.claims_now();
        self.give_back(&mut state);
        let mut holders = state.holders.iter_mut();
        if let Some(holder) = holders.find(|holder| holder.number == self.number) {
            holder.sent = Some(Arc::clone(&pending.request));
        }
    }

    /// Whether anything of this has to be written to the drive.
    pub fn has_to_write(&self, by_sdo: &BySdo) -> bool {
        let written = self.written.as_ref();
        written.is_some_and(|written| by_sdo.is_needed(written))
    }

    /// What was written is known to all from now on.
    fn give_back(&mut self, state: &mut State) {
        let Some(mut written) = self.written.take() else {
            return;
        };
        if self.start == state.start {
            state.written = written;
        } else {
            written.keep_unread();
            state.written.add(written);
        }
    }
}

impl Drop for Claim<'_> {
    fn drop(&mut self) {
        let waiting = {
            let mut state = self.handles.claims_now();
            self.give_back(&mut state);
            state
                .holders
                .retain(|holder| holder.number != self.number || holder.sent.is_some());
            core::mem::take(&mut state.waiting)
        };
        waiting.into_iter().for_each(Waker::wake);
    }
}

/// What a move needs written by SDO.
#[derive(Debug, Default)]
pub(super) struct BySdo {
    /// Of the move's parameters.
    writes: Vec<(ObjectAddress, Vec<u8>)>,
    /// The objects that it leaves out.
    left_out: Vec<ObjectAddress>,
    /// A speed of zero.
    pub zero: Option<&'static str>,
}

/// The objects that moves of an axis have written by SDO, since its drive was brought up or led back.
#[derive(Debug, Default)]
pub(super) struct WrittenParameters {
    written: Vec<Written>,
}

#[derive(Debug)]
struct Written {
    object: ObjectAddress,
    /// What the drive held before the first move wrote it.
    before: Vec<u8>,
    /// Whether the drive may hold something else now.
    changed: bool,
}

impl BySdo {
    /// Takes those parameters out of a move that do not go into the process data. Its end velocity stays: the axis goes on at it.
    pub fn take(fields: &AxisFields, parameters: &mut Parameters) -> Self {
        let mut this = Self::default();
        this.speed(
            fields.velocity.is_some(),
            &mut parameters.velocity,
            obj::PROFILE_VELOCITY,
            "profile velocity 6081h",
        );
        this.speed(
            fields.acceleration.is_some(),
            &mut parameters.acceleration,
            obj::PROFILE_ACCELERATION,
            "profile acceleration 6083h",
        );
        this.speed(
            fields.deceleration.is_some(),
            &mut parameters.deceleration,
            obj::PROFILE_DECELERATION,
            "profile deceleration 6084h",
        );
        let mut end_velocity = parameters.end_velocity;
        this.other(
            fields.end_velocity.is_some(),
            &mut end_velocity,
            obj::END_VELOCITY,
        );
        this.other(
            fields.profile_type.is_some(),
            &mut parameters.profile_type,
            obj::MOTION_PROFILE_TYPE,
        );
        this
    }

    /// None where everything goes with the process data.
    pub fn some(self) -> Option<Self> {
        let nothing = self.writes.is_empty() && self.left_out.is_empty();
        (!nothing).then_some(self)
    }

    /// Whether anything has to be written to the drive, of whose objects this is known.
    fn is_needed(&self, written: &WrittenParameters) -> bool {
        !self.writes.is_empty() || written.any_changed()
    }

    /// Makes the drive's objects what this motion wants, which has claimed them.
    pub async fn write(self, claim: &mut Claim<'_>) -> Result<(), AxisError> {
        let (handles, of) = (claim.handles, claim.start);
        let Some(written) = &mut claim.written else {
            return Ok(());
        };
        for object in self.left_out {
            // What a move leaves out is again what the drive held.
            if let Some(before) = written.to_set_back(object) {
                handles.is_of(of)?;
                handles.write_parameter(object, before).await?;
                written.is_set_back(object);
                handles.claims.step();
            }
        }
        for (object, value) in self.writes {
            // Said before: a caller may give up in between.
            if !written.will_change(object) {
                let before = handles.read_parameter(object).await?;
                written.note(object, before);
                handles.claims.step();
            }
            handles.is_of(of)?;
            handles.write_parameter(object, value).await?;
            handles.claims.step();
        }
        Ok(())
    }

    fn speed<A: Writable>(
        &mut self,
        mapped: bool,
        value: &mut Option<u32>,
        object: Object<u32, A>,
        name: &'static str,
    ) {
        // A mapped one as well: what is refused for it must not have written the others.
        if *value == Some(0) {
            self.zero = Some(name);
        }
        self.other(mapped, value, object);
    }

    fn other<T: Number, A: Writable>(
        &mut self,
        mapped: bool,
        value: &mut Option<T>,
        object: Object<T, A>,
    ) {
        if mapped {
            return;
        }
        match value.take() {
            Some(value) => self.writes.push((object.address(), value.encode())),
            None => self.left_out.push(object.address()),
        }
    }
}

impl WrittenParameters {
    /// Whether the drive may hold a parameter of an earlier move.
    fn any_changed(&self) -> bool {
        self.written.iter().any(|written| written.changed)
    }

    /// What the drive held in this object, where it may hold something else now.
    fn to_set_back(&self, object: ObjectAddress) -> Option<Vec<u8>> {
        let mut changed = self.written.iter().filter(|written| written.changed);
        changed
            .find(|written| written.object == object)
            .map(|written| written.before.clone())
    }

    /// The drive has been brought up, or led back: what was read at the first start was written to it. 6086h was not, where it is not mapped.
    fn keep_unread(&mut self) {
        let unread = obj::MOTION_PROFILE_TYPE.address();
        self.written.retain(|written| written.object == unread);
        self.written
            .iter_mut()
            .for_each(|written| written.changed = true);
    }

    /// Those of another claim too.
    fn add(&mut self, other: Self) {
        for written in other.written {
            if !self.will_change(written.object) {
                self.written.push(written);
            }
        }
    }

    fn is_set_back(&mut self, object: ObjectAddress) {
        for written in &mut self.written {
            written.changed &= written.object != object;
        }
    }

    /// This object is about to be written. Whether it is known what the drive held there.
    fn will_change(&mut self, object: ObjectAddress) -> bool {
        let known = self
            .written
            .iter_mut()
            .find(|written| written.object == object);
        known.map(|written| written.changed = true).is_some()
    }

    fn note(&mut self, object: ObjectAddress, before: Vec<u8>) {
        self.written.push(Written {
            object,
            before,
            changed: true,
        });
    }
}
