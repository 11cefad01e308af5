//! The one loop that everything on the bus goes through: frames out and in, cycles on time, acyclic futures in the gaps.
//!
//! It never blocks but in the link's `wait`, so that one lost frame holds nothing up, and takes its time from the link, so
//! that tests run it in virtual time without a thread.

use std::{
    cell::{Cell, RefCell},
    future::Future,
    rc::{Rc, Weak},
    sync::Arc,
    time::Duration,
};

use async_task::Task;
use ethercrab::{MainDevice, MainDeviceConfig, PduStorage, Timeouts};

use super::{
    Receiving, acyclic::Acyclic, control::Control, cycle::Cycle, frame::Tag, gap::Gap, log::Log,
    receiving::Awaited, registers::Registers, statistics::Counters, tasks::Tasks, time::Time,
};
use crate::{
    coe::{Emergencies, EmergencyQueue},
    link::{LONGEST_FRAME, Link},
    wakes::Wakes,
};

/// Frames of ethercrab's that can be on their way at once (a power of two; ethercrab takes 128 at most).
pub(super) const SLOTS: usize = 64;
/// The longest datagram that fits into an Ethernet frame.
const LONGEST_DATAGRAM: usize = 1486;
/// The longest wait: wakes from other threads reach the executor's tasks, but not the link.
const LONGEST_WAIT: Duration = Duration::from_millis(1);
/// Emergencies of all drives together that are kept for a program that has not taken them.
const EMERGENCIES: usize = 256;
/// Tasks polled in one turn before the link is looked at again.
const POLLS_PER_TURN: usize = 64;
/// Frames received in one turn.
const FRAMES_PER_TURN: usize = 256;

/// What the futures on the bus thread share with the loop.
#[derive(Clone)]
pub(super) struct Context {
    pub(super) registers: Registers,
    pub(super) time: Rc<Time>,
    /// Weak, because its tasks hold contexts: with the loop they are all dropped, and nobody waits for them any more.
    tasks: Weak<Tasks>,
    pub(super) cycle: Rc<RefCell<Option<Cycle>>>,
    pub(super) counters: Arc<Counters>,
    pub(super) log: Log,
    /// Who wakes the program's futures.
    pub(super) wakes: Wakes,
    /// Those of all drives: where they go in, and where they come out.
    pub(super) emergencies: (EmergencyQueue, Emergencies),
    over: Rc<Cell<bool>>,
}

impl Context {
    /// Begins a task; none if the loop is gone.
    pub(super) fn spawn<T: 'static>(
        &self,
        future: impl Future<Output = T> + 'static,
    ) -> Option<Task<T>> {
        Some(self.tasks.upgrade()?.spawn(future))
    }

    /// Ends the loop after this turn.
    pub(super) fn end(&self) {
        self.over.set(true);
    }
}

/// The loop and what it owns.
pub(super) struct Reactor {
    link: Box<dyn Link>,
    acyclic: Acyclic,
    tasks: Rc<Tasks>,
    context: Context,
    receiving: Receiving,
    buffer: Vec<u8>,
}

impl Reactor {
    /// Makes the storage that ethercrab needs, which lives as long as the process.
    pub(super) fn new(
        link: Box<dyn Link>,
        receiving: Receiving,
        control: &Control,
        log: Log,
    ) -> Self {
        type Storage = PduStorage<SLOTS, { PduStorage::element_size(LONGEST_DATAGRAM) }>;
        let storage: &'static Storage = Box::leak(Box::new(PduStorage::new()));
        let time = Rc::new(Time::default());
        time.advance(link.now());
        #[expect(
            clippy::unwrap_used,
            reason = "it fails only when it is done twice, and the storage was made here"
        )]
        let (tx, rx, pdus) = storage.try_split().unwrap();
        // All deadlines are ours: a timer of ethercrab's costs more than a frame, and knows no virtual time.
        // The pause in its wait loops is no deadline and stays.
        let timeouts = Timeouts {
            state_transition: Duration::MAX,
            pdu: Duration::MAX,
            eeprom: Duration::MAX,
            wait_loop_delay: Duration::ZERO,
            mailbox_echo: Duration::MAX,
            mailbox_response: Duration::MAX,
        };
        let config = MainDeviceConfig {
            dc_static_sync_iterations: 0,
            ..MainDeviceConfig::default()
        };
        let main = Box::leak(Box::new(MainDevice::new(pdus, timeouts, config)));
        let tasks = Rc::new(Tasks::new());
        Self {
            link,
            acyclic: Acyclic::new(tx, rx),
            context: Context {
                registers: Registers::new(main, Rc::clone(&time)),
                time,
                tasks: Rc::downgrade(&tasks),
                cycle: Rc::new(RefCell::new(None)),
                counters: Arc::clone(&control.counters),
                log,
                emergencies: EmergencyQueue::new(EMERGENCIES, control.wakes.waiters()),
                wakes: control.wakes.clone(),
                over: Rc::new(Cell::new(false)),
            },
            tasks,
            receiving,
            buffer: vec![0; LONGEST_FRAME],
        }
    }

    pub(super) fn now(&self) -> Duration {
        self.link.now()
    }

    pub(super) fn wakes(&self) -> &Wakes {
        &self.context.wakes
    }

    pub(super) fn context(&self) -> &Context {
        &self.context
    }

    /// One turn. False once the loop is over.
    pub(super) fn turn(&mut self) -> bool {
        let now = self.link.now();
        self.context.time.advance(now);
        if !self.is_cycle_due(now) {
            self.receive(now);
        }
        let next = self.exchange(now);
        // At once: an outcome is worth a hand-over behind its frame.
        self.context.wakes.hand_over();
        let mut busy = false;
        if !next.is_some_and(|next| next.in_flight) {
            busy = self.acyclic_work(next.map(|next| next.gap));
            self.context.log.hand_over();
            self.context.wakes.hand_over();
        }
        if !busy {
            self.wait(now, next);
        }
        !self.context.over.get()
    }

    /// Whether a cycle is to be sent before anything else is looked at.
    fn is_cycle_due(&self, now: Duration) -> bool {
        let cycle = self.context.cycle.borrow();
        cycle.as_ref().is_some_and(|cycle| cycle.is_due(now))
    }

    /// Receives until nothing is left, or a cycle is complete: then that comes first.
    fn receive(&mut self, now: Duration) {
        for _ in 0..FRAMES_PER_TURN {
            // What the operating system refuses shows as lost frames.
            let Ok(Some(length)) = self.link.receive(&mut self.buffer) else {
                return;
            };
            let Some(frame) = self.buffer.get(..length) else {
                return;
            };
            let counters = &self.context.counters;
            let mut cycle = self.context.cycle.borrow_mut();
            match (Tag::of_answer(frame), &mut *cycle) {
                (Some(Tag::Acyclic(number)), cycle) => {
                    let sent = cycle.as_ref().map(Cycle::sent);
                    self.acyclic.accept(number, frame, sent, counters);
                }
                (Some(tag), Some(cycle)) => {
                    if cycle.accept(tag, frame, now, counters) {
                        return;
                    }
                }
                (Some(_), None) => counters.late.add(),
                (None, _) => counters.foreign.add(),
            }
        }
    }

    /// Ends the cycle that is due or complete, begins the next one if it is time.
    fn exchange(&mut self, now: Duration) -> Option<Next> {
        let mut cycle = self.context.cycle.borrow_mut();
        let cycle = cycle.as_mut()?;
        cycle.turn(now, &mut *self.link, &self.context.counters);
        Some(Next {
            at: cycle.next(),
            in_flight: cycle.in_flight(),
            sent: cycle.sent(),
            gap: cycle.gap(),
        })
    }

    /// Polls futures, then sends what they queued. True if there may be more to do at once.
    fn acyclic_work(&mut self, gap: Option<Gap>) -> bool {
        if self.acyclic.has_work(self.context.time.now()) && !self.send_acyclic(gap) {
            // What futures would ask for now had to wait behind that.
            return false;
        }
        let mut polls = 0;
        let mut more = !self.acyclic.is_ahead();
        while more && polls < POLLS_PER_TURN {
            if polls % 8 == 7 && gap.is_some_and(|gap| self.link.now() >= gap.end) {
                break;
            }
            more = self.tasks.poll_one();
            polls += usize::from(more);
        }
        // Futures may have been dropped above, and none will be before ethercrab's frames are sent.
        if polls > 0 {
            more &= self.send_acyclic(gap);
        }
        more
    }

    /// False while frames wait for room.
    fn send_acyclic(&mut self, gap: Option<Gap>) -> bool {
        let counters = &self.context.counters;
        self.acyclic.send(&mut *self.link, gap, counters)
    }

    /// `now` is when the turn began: what has become due since then ends the sleep at once.
    fn wait(&mut self, now: Duration, next: Option<Next>) {
        let cycle = next.map(|next| next.at);
        let until = if next.is_some_and(|next| next.in_flight) {
            // Nothing else is served before the cycle is over.
            cycle
        } else {
            [cycle, self.context.time.next(), self.acyclic.next()]
                .into_iter()
                .flatten()
                .min()
        };
        let longest = now.saturating_add(LONGEST_WAIT);
        let until = until.map_or(longest, |until| until.min(longest));
        if until <= now {
            return;
        }
        let awaited = match next {
            None => Awaited::Nothing,
            Some(next) if next.in_flight => Awaited::Frames { sent: next.sent },
            Some(next) => Awaited::Cycle { start: next.at },
        };
        match self.receiving.sleep(now, until, awaited) {
            None => self.link.pause(),
            Some(until) => self.link.wait(until),
        }
    }
}

#[derive(Clone, Copy)]
struct Next {
    at: Duration,
    in_flight: bool,
    sent: Duration,
    gap: Gap,
}
