//! How transfers get from any thread to the mailbox client, and their outcomes back: through places that are made once.
//!
//! On the client's thread nothing is allocated and nothing freed. A dialogue brings its buffers along and goes back with them. What
//! a caller that went away has left behind stays in its place until the next caller takes that one.

use alloc::boxed::Box;
use alloc::sync::Arc;
use core::future::poll_fn;
use core::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use core::task::Poll;
use core::time::Duration;

use atomic_waker::AtomicWaker;
use crossbeam_queue::ArrayQueue;
use smol::channel::{Receiver, Sender, bounded};

use super::client::{Dialogue, Failure, MailboxSettings};
use super::error::Transfer;
use crate::wakes::Waiters;

/// Bytes that are got ready for an answer of unknown length, as long as none was longer: more than most objects have.
const USUAL_ROOM: usize = 4096;

/// A transfer on its way to the client.
#[derive(Debug)]
pub(super) struct Request {
    pub(super) transfer: Transfer,
    /// With room for what it will hold.
    pub(super) dialogue: Dialogue,
    /// The time for each reply.
    pub(super) timeout: Duration,
}

/// A transfer that is over.
#[derive(Debug)]
pub(super) struct Answer {
    pub(super) dialogue: Dialogue,
    pub(super) result: Result<(), Failure>,
}

/// A request and where its answer goes.
#[derive(Debug)]
pub(super) struct Call {
    pub(super) request: Request,
    pub(super) place: Arc<Place>,
}

/// Where a caller waits for its answer.
#[derive(Debug)]
pub(super) struct Place {
    /// Room for one.
    answer: ArrayQueue<Answer>,
    caller: AtomicWaker,
    /// One of both, caller and client, is through with the call.
    left: AtomicBool,
}

impl Place {
    /// Whether the caller of a call that is not answered has gone away.
    pub(super) fn is_left(&self) -> bool {
        self.left.load(Ordering::Acquire)
    }
}

#[derive(Debug)]
struct Calls {
    places: Box<[Arc<Place>]>,
    free: (Sender<Arc<Place>>, Receiver<Arc<Place>>),
    /// Room for a call from each place.
    waiting: ArrayQueue<Call>,
    client: AtomicWaker,
    /// The program's futures that wait for an answer, or for a place.
    waiters: Arc<Waiters>,
    callers_gone: AtomicBool,
    client_gone: AtomicBool,
    settings: MailboxSettings,
    /// Bytes of the longest answer, or the usual room.
    longest: AtomicUsize,
}

/// The callers' end and the client's.
pub(super) fn calls(settings: MailboxSettings, waiters: Arc<Waiters>) -> (Callers, Served) {
    // One is served while the others wait.
    let count = settings.request_capacity.max(1).saturating_add(1);
    let place = || Place {
        answer: ArrayQueue::new(1),
        caller: AtomicWaker::new(),
        left: AtomicBool::new(false),
    };
    let places: Box<[_]> = (0..count).map(|_| Arc::new(place())).collect();
    let free = bounded(count);
    for place in &places {
        // There is room for all.
        let _ = free.0.try_send(Arc::clone(place));
    }
    let calls = Arc::new(Calls {
        places,
        free,
        waiting: ArrayQueue::new(count),
        client: AtomicWaker::new(),
        waiters,
        callers_gone: AtomicBool::new(false),
        client_gone: AtomicBool::new(false),
        settings,
        longest: AtomicUsize::new(USUAL_ROOM),
    });
    (Callers(Arc::clone(&calls)), Served(calls))
}

impl Calls {
    /// Caller and client leave a place once each; with the second one it is free again.
    fn leave(&self, place: &Arc<Place>) {
        if place.left.swap(true, Ordering::AcqRel) {
            place.left.store(false, Ordering::Release);
            let _ = self.free.0.try_send(Arc::clone(place));
        }
    }
}

/// The end of the callers; without it the client ends.
#[derive(Debug)]
pub(super) struct Callers(Arc<Calls>);

impl Callers {
    pub(super) fn settings(&self) -> &MailboxSettings {
        &self.0.settings
    }

    /// Bytes that an answer of unknown length is to be given: no answer before was longer.
    pub(super) fn room(&self) -> usize {
        self.0.longest.load(Ordering::Relaxed)
    }

    /// Hands `request` to the client, once there is a place for it, and waits for its answer; `None` if the client is gone.
    pub(super) async fn call(&self, request: Request) -> Option<Answer> {
        self.0.waiters.relay(self.call_directly(request)).await
    }

    async fn call_directly(&self, request: Request) -> Option<Answer> {
        let calls = &*self.0;
        let place = calls.free.1.recv().await.ok()?;
        let seated = Seated { calls, place };
        let place = &seated.place;
        drop(place.answer.pop());
        let call = Call {
            request,
            place: Arc::clone(place),
        };
        calls.waiting.push(call).ok()?;
        calls.client.wake();
        poll_fn(|context| {
            place.caller.register(context.waker());
            // Looked at first: what the client has answered before it went is an answer.
            let is_gone = calls.client_gone.load(Ordering::Acquire);
            match place.answer.pop() {
                None if !is_gone => Poll::Pending,
                answer => Poll::Ready(answer),
            }
        })
        .await
    }
}

impl Drop for Callers {
    fn drop(&mut self) {
        self.0.callers_gone.store(true, Ordering::Release);
        self.0.client.wake();
    }
}

/// A caller in its place.
struct Seated<'a> {
    calls: &'a Calls,
    place: Arc<Place>,
}

impl Drop for Seated<'_> {
    fn drop(&mut self) {
        self.place.caller.take();
        self.calls.leave(&self.place);
    }
}

/// The end of the client; without it all calls end.
pub(super) struct Served(Arc<Calls>);

impl Served {
    /// The next call; `None` if nobody can call any more.
    pub(super) async fn next(&self) -> Option<Call> {
        let calls = &*self.0;
        poll_fn(|context| {
            calls.client.register(context.waker());
            // Looked at first: what was asked before the last caller went is asked.
            let are_gone = calls.callers_gone.load(Ordering::Acquire);
            match calls.waiting.pop() {
                None if !are_gone => Poll::Pending,
                call => Poll::Ready(call),
            }
        })
        .await
    }

    /// Gives a call's answer to its caller, or leaves it in its place.
    pub(super) fn answer(&self, place: &Arc<Place>, answer: Answer) {
        self.0
            .longest
            .fetch_max(answer.dialogue.room_taken(), Ordering::Relaxed);
        // The caller has emptied the place.
        let _ = place.answer.push(answer);
        self.0.leave(place);
        place.caller.wake();
    }
}

impl Drop for Served {
    fn drop(&mut self) {
        self.0.client_gone.store(true, Ordering::Release);
        self.0.free.0.close();
        for place in &self.0.places {
            place.caller.wake();
        }
    }
}

#[cfg(test)]
mod tests;
