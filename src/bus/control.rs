//! What a program's thread and the bus thread share beside the axes: stops of all axes, the end, what happened.

use std::sync::{
    Arc, OnceLock,
    atomic::{AtomicBool, AtomicU8, Ordering},
};
use std::task::Waker;
use std::thread::JoinHandle;

use crossbeam_queue::SegQueue;
use smol::channel::{Receiver, Sender};

use super::{
    AlStatus, BlackBox, DevicePorts, Miscounted, MovingAxis, NetworkError, Recovered,
    RegisterError, beat::Beat, progress::StepDone, statistics::Counters,
};
use crate::{
    axis::{LivenessWatch, StopRequest},
    coe::DriveId,
    wakes::{Waiters, Wakes},
};

/// Network events that are kept for a program that does not look, beside four for each device: those of a whole line come at once.
const EVENTS: usize = 64;
const EVENTS_OF_A_DEVICE: usize = 4;
/// Of these, how many black boxes may take: what happened is told before how.
const BLACK_BOXES: usize = 32;
/// Questions that may wait for the bus thread.
const QUESTIONS: usize = 16;

/// What a program asks of the bus thread.
pub(super) enum Question {
    /// The last cycles of the axis at this place.
    BlackBox(usize, Sender<BlackBox>),
    /// The error counters of all ports.
    Ports(Sender<Result<Vec<DevicePorts>, RegisterError>>),
    /// That the device at this place of the exchange be led back into OP, and how far it is be told.
    Recover(
        usize,
        Sender<StepDone>,
        Sender<Result<Recovered, NetworkError>>,
    ),
}

#[derive(Debug)]
pub(super) struct Control {
    shutdown: AtomicBool,
    stop: AtomicU8,
    watches: SegQueue<LivenessWatch>,
    waker: OnceLock<Waker>,
    pub(super) counters: Arc<Counters>,
    pub(super) beat: Arc<Beat>,
    pub(super) wakes: Wakes,
    /// The program's futures that wait for what the bus thread sends.
    pub(super) waiters: Arc<Waiters>,
    pub(super) events: (Sender<NetworkEvent>, Receiver<NetworkEvent>),
    pub(super) questions: (Sender<Question>, Receiver<Question>),
    /// At the end, the axes that were not seen to stand.
    pub(super) left_moving: OnceLock<Vec<MovingAxis>>,
}

impl Control {
    /// For so many devices.
    pub(super) fn new(devices: usize, wakes: Wakes) -> Arc<Self> {
        Arc::new(Self {
            shutdown: AtomicBool::new(false),
            stop: AtomicU8::new(0),
            watches: SegQueue::new(),
            waker: OnceLock::new(),
            counters: Arc::default(),
            beat: Beat::new(&wakes),
            waiters: wakes.waiters(),
            wakes,
            events: smol::channel::bounded(EVENTS + EVENTS_OF_A_DEVICE * devices),
            questions: smol::channel::bounded(QUESTIONS),
            left_moving: OnceLock::new(),
        })
    }

    /// Lets requests end the link's wait.
    pub(super) fn set_waker(&self, waker: Waker) {
        // A second one would be of the same loop.
        let _ = self.waker.set(waker);
    }

    pub(super) fn request_stop(&self, stop: StopRequest) {
        self.stop.fetch_or(stop.bits(), Ordering::Release);
    }

    pub(super) fn take_stop(&self) -> StopRequest {
        StopRequest::from_bits_truncate(self.stop.swap(0, Ordering::AcqRel))
    }

    pub(super) fn request_shutdown(&self) {
        self.shutdown.store(true, Ordering::Release);
        if let Some(waker) = self.waker.get() {
            waker.wake_by_ref();
        }
    }

    pub(super) fn is_shutdown(&self) -> bool {
        self.shutdown.load(Ordering::Acquire)
    }

    /// Hands a liveness rule to the bus thread.
    pub(super) fn add_watch(&self, watch: LivenessWatch) {
        self.watches.push(watch);
    }

    pub(super) fn take_watch(&self) -> Option<LivenessWatch> {
        self.watches.pop()
    }

    /// Nothing more happens: whoever waits for events is told so, once they have taken those that are there.
    pub(super) fn end_events(&self) {
        self.events.0.close();
    }

    /// Keeps the event if there is room; a program that does not look loses the later ones.
    pub(super) fn report(&self, event: NetworkEvent) {
        if matches!(event, NetworkEvent::Trouble(_)) && self.events.0.len() >= BLACK_BOXES {
            return;
        }
        drop(self.events.0.try_send(event));
    }
}

/// Ends what was begun when nobody waits for it any more, and waits for its thread: whoever begins again finds the link free.
pub(super) struct Guard {
    control: Option<Arc<Control>>,
    thread: Option<JoinHandle<()>>,
}

impl Guard {
    pub(super) const fn new(control: Arc<Control>) -> Self {
        Self {
            control: Some(control),
            thread: None,
        }
    }

    /// Where the program waits for what is being made.
    pub(super) fn waiters(&self) -> Arc<Waiters> {
        let control = self.control.as_ref();
        control.map_or_else(Waiters::direct, |control| Arc::clone(&control.waiters))
    }

    /// Takes the thread in.
    pub(super) fn watch(&mut self, thread: JoinHandle<()>) {
        self.thread = Some(thread);
    }

    /// Waits until a loop that has failed, and the link with it, is gone: whoever tries again finds the link free. A program that turns
    /// the loop itself sees to that itself.
    pub(super) async fn gone(self, over: &Receiver<()>) {
        if self.thread.is_some()
            && let Some(control) = &self.control
        {
            let _ = control.waiters.relay(over.recv()).await;
        }
    }

    /// Ends nothing any more.
    pub(super) fn release(mut self) -> (Option<Arc<Control>>, Option<JoinHandle<()>>) {
        (self.control.take(), self.thread.take())
    }
}

impl Drop for Guard {
    fn drop(&mut self) {
        if let Some(control) = &self.control {
            control.request_shutdown();
        }
        if let Some(thread) = self.thread.take() {
            // Only a panic fails it, and that has been told.
            let _ = thread.join();
        }
    }
}

/// Something that happened to a drive of a running network.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub enum NetworkEvent {
    /// It no longer answers; its axes count as lost.
    Lost(DriveId),
    /// It answers again.
    Back(DriveId),
    /// It left OP: its axes no longer act on what they are told.
    LeftOp {
        /// The drive.
        drive: DriveId,
        /// The state it is in, and why.
        status: AlStatus,
    },
    /// It is in OP again.
    InOp(DriveId),
    /// One of its axes has a fault, or counts as lost: with what its last cycles were. Told some milliseconds later, so that
    /// they hold what came of it.
    Trouble(Arc<BlackBox>),
    /// The working counter of a datagram stays wrong although its devices answer: whose outputs are delivered is not known, and their axes
    /// count as lost. With what the registers of each device show.
    Miscounted(Arc<Miscounted>),
    /// The cycles and the reference clock of the distributed clocks.
    Clock {
        /// The SubDevice whose clock is the reference.
        reference: DriveId,
        /// What happened.
        event: ClockEvent,
    },
}

/// What happened between the cycles and the reference clock.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum ClockEvent {
    /// The phase error is beyond its bound again and again. Drives that cannot live with that say so themselves.
    OutOfStep {
        /// The last cycle's, in nanoseconds.
        phase_error_ns: i64,
    },
    /// The cycles are in step again.
    InStep,
    /// The clock no longer gives its time. The cycles go on at the speed that it had, and all other clocks follow them. It may
    /// be lost, or have been switched off and on: then the network is to be started anew.
    Silent,
    /// The clock shows a time that it cannot have. All clocks follow the cycles from now on, which go on at the speed that they
    /// had, and all axes were told to stop and disable, as at the network's end; it is to be started anew.
    Jumped {
        /// By how much it jumped, less multiples of 2^32, in nanoseconds.
        by_ns: i64,
    },
}

impl std::fmt::Display for ClockEvent {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::OutOfStep { phase_error_ns } => write!(
                f,
                "the cycles are out of step with the reference clock: the phase error is {phase_error_ns} ns"
            ),
            Self::InStep => f.write_str("the cycles are in step with the reference clock"),
            Self::Silent => {
                f.write_str("the reference clock gives no time: the cycles go on by themselves")
            }
            Self::Jumped { by_ns } => write!(
                f,
                "the reference clock has jumped by {by_ns} ns: all axes stop and are disabled"
            ),
        }
    }
}

impl NetworkEvent {
    /// The drive, or other device, that it happened to.
    #[must_use]
    pub fn drive(&self) -> &DriveId {
        match self {
            Self::Lost(drive) | Self::Back(drive) | Self::InOp(drive) => drive,
            Self::LeftOp { drive, .. } => drive,
            Self::Trouble(black_box) => &black_box.axis.drive,
            Self::Miscounted(miscounted) => miscounted.suspect(),
            Self::Clock { reference, .. } => reference,
        }
    }
}

impl std::fmt::Display for NetworkEvent {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Lost(drive) => write!(f, "{drive} no longer answers"),
            Self::Back(drive) => write!(f, "{drive} answers again"),
            Self::LeftOp { drive, status } => write!(f, "{drive} has left OP: it is in {status}"),
            Self::InOp(drive) => write!(f, "{drive} is in OP again"),
            Self::Trouble(black_box) => write!(f, "{black_box}"),
            Self::Miscounted(miscounted) => write!(f, "{miscounted}"),
            Self::Clock { reference, event } => write!(f, "{reference}: {event}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn who_goes_away_while_a_failed_loop_ends_waits_for_its_thread() {
        let (wakes, end) = Wakes::in_turn();
        let control = Control::new(0, wakes);
        drop(end);
        let (alive, over) = smol::channel::bounded(1);
        let gone = Arc::new(AtomicBool::new(false));
        let (of_loop, is_gone) = (Arc::clone(&control), Arc::clone(&gone));
        let mut guard = Guard::new(control);
        guard.watch(std::thread::spawn(move || {
            while !of_loop.is_shutdown() {
                std::thread::yield_now();
            }
            is_gone.store(true, Ordering::Release);
            drop(alive);
        }));
        let given_up = smol::future::poll_once(guard.gone(&over));
        assert_eq!(smol::block_on(given_up), None);
        assert!(gone.load(Ordering::Acquire));
    }
}
