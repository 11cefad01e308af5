//! What happens while cycles run, and what a program's thread and the bus thread share beside the axes: stops of all axes, the end, events.
//!
//! `al_monitor` follows the AL states, `miscount` the working counters, `port_errors` reads the ports, `transition_log` notes what happens to
//! axes. They report through [`Control`]. They look and tell; they must not change a device, which `network` does.

pub(super) mod al_monitor;
pub(super) mod miscount;
pub(super) mod port_errors;
pub(super) mod transition_log;

use std::{
    sync::{
        Arc, OnceLock,
        atomic::{AtomicBool, AtomicU8, Ordering},
    },
    task::Waker,
    thread::JoinHandle,
};

use crossbeam_queue::SegQueue;
use smol::channel::{Receiver, Sender};

use crate::{
    axis::{LivenessWatch, StopRequest},
    bus::{
        cycle::{CycleTick, black_box::BlackBox, statistics::Counters},
        device::progress::StepDone,
        error::{MovingAxis, NetworkError, RegisterError},
        event::{NetworkEvent, Recovered},
        watch::port_errors::DevicePorts,
    },
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
pub(in crate::bus) enum Question {
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
pub(in crate::bus) struct Control {
    shutdown: AtomicBool,
    stop: AtomicU8,
    watches: SegQueue<LivenessWatch>,
    waker: OnceLock<Waker>,
    pub(in crate::bus) counters: Arc<Counters>,
    pub(in crate::bus) tick: Arc<CycleTick>,
    pub(in crate::bus) wakes: Wakes,
    /// The program's futures that wait for what the bus thread sends.
    pub(in crate::bus) waiters: Arc<Waiters>,
    pub(in crate::bus) events: (Sender<NetworkEvent>, Receiver<NetworkEvent>),
    pub(in crate::bus) questions: (Sender<Question>, Receiver<Question>),
    /// At the end, the axes that were not seen to stand.
    pub(in crate::bus) left_moving: OnceLock<Vec<MovingAxis>>,
}

impl Control {
    /// For so many devices.
    pub(in crate::bus) fn new(devices: usize, wakes: Wakes) -> Arc<Self> {
        Arc::new(Self {
            shutdown: AtomicBool::new(false),
            stop: AtomicU8::new(0),
            watches: SegQueue::new(),
            waker: OnceLock::new(),
            counters: Arc::default(),
            tick: CycleTick::new(&wakes),
            waiters: wakes.waiters(),
            wakes,
            events: smol::channel::bounded(EVENTS + EVENTS_OF_A_DEVICE * devices),
            questions: smol::channel::bounded(QUESTIONS),
            left_moving: OnceLock::new(),
        })
    }

    /// Lets requests end the link's wait.
    pub(in crate::bus) fn set_waker(&self, waker: Waker) {
        // A second one would be of the same loop.
        let _ = self.waker.set(waker);
    }

    pub(in crate::bus) fn request_stop(&self, stop: StopRequest) {
        self.stop.fetch_or(stop.bits(), Ordering::Release);
    }

    pub(in crate::bus) fn take_stop(&self) -> StopRequest {
        StopRequest::from_bits_truncate(self.stop.swap(0, Ordering::AcqRel))
    }

    pub(in crate::bus) fn request_shutdown(&self) {
        self.shutdown.store(true, Ordering::Release);
        if let Some(waker) = self.waker.get() {
            waker.wake_by_ref();
        }
    }

    pub(in crate::bus) fn is_shutdown(&self) -> bool {
        self.shutdown.load(Ordering::Acquire)
    }

    /// Hands a liveness rule to the bus thread.
    pub(in crate::bus) fn add_watch(&self, watch: LivenessWatch) {
        self.watches.push(watch);
    }

    pub(in crate::bus) fn take_watch(&self) -> Option<LivenessWatch> {
        self.watches.pop()
    }

    /// Nothing more happens: whoever waits for events is told so, once they have taken those that are there.
    pub(in crate::bus) fn end_events(&self) {
        self.events.0.close();
    }

    /// Keeps the event if there is room; a program that does not look loses the later ones.
    pub(in crate::bus) fn report(&self, event: NetworkEvent) {
        if matches!(event, NetworkEvent::AxisIncident(_)) && self.events.0.len() >= BLACK_BOXES {
            return;
        }
        drop(self.events.0.try_send(event));
    }
}

/// Ends what was begun when nobody waits for it any more, and waits for its thread: whoever begins again finds the link free.
pub(in crate::bus) struct Guard {
    control: Option<Arc<Control>>,
    thread: Option<JoinHandle<()>>,
}

impl Guard {
    pub(in crate::bus) const fn new(control: Arc<Control>) -> Self {
        Self {
            control: Some(control),
            thread: None,
        }
    }

    /// Where the program waits for what is being made.
    pub(in crate::bus) fn waiters(&self) -> Arc<Waiters> {
        let control = self.control.as_ref();
        control.map_or_else(Waiters::direct, |control| Arc::clone(&control.waiters))
    }

    /// Takes the thread in.
    pub(in crate::bus) fn watch(&mut self, thread: JoinHandle<()>) {
        self.thread = Some(thread);
    }

    /// Waits until a loop that has failed, and the link with it, is gone: whoever tries again finds the link free. A program that turns
    /// the loop itself sees to that itself.
    pub(in crate::bus) async fn gone(self, over: &Receiver<()>) {
        if self.thread.is_some()
            && let Some(control) = &self.control
        {
            let _ = control.waiters.relay(over.recv()).await;
        }
    }

    /// Ends nothing any more.
    pub(in crate::bus) fn release(mut self) -> (Option<Arc<Control>>, Option<JoinHandle<()>>) {
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
