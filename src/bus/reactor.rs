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
    acyclic::Acyclic, cycle::Cycle, frame::Tag, registers::Registers, statistics::Counters,
    tasks::Tasks, time::Time,
};
use crate::{
    coe::{Emergencies, EmergencyQueue},
    link::{LONGEST_FRAME, Link},
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
    buffer: Vec<u8>,
}

impl Reactor {
    /// Makes the storage that ethercrab needs, which lives as long as the process.
    pub(super) fn new(link: Box<dyn Link>, counters: Arc<Counters>) -> Self {
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
                counters,
                emergencies: EmergencyQueue::new(EMERGENCIES),
                over: Rc::new(Cell::new(false)),
            },
            tasks,
            buffer: vec![0; LONGEST_FRAME],
        }
    }

    pub(super) fn now(&self) -> Duration {
        self.link.now()
    }

    pub(super) fn context(&self) -> &Context {
        &self.context
    }

    /// One turn. False once the loop is over.
    pub(super) fn turn(&mut self) -> bool {
        let now = self.link.now();
        self.context.time.advance(now);
        self.receive();
        let next = self.exchange(now);
        let in_flight = next.is_some_and(|next| next.in_flight);
        let mut busy = false;
        if !in_flight {
            busy = self.acyclic_work(next.map(|next| next.at));
        }
        if !busy {
            self.wait(next);
        }
        !self.context.over.get()
    }

    fn receive(&mut self) {
        for _ in 0..FRAMES_PER_TURN {
            // What the operating system refuses shows as lost frames.
            let Ok(Some(length)) = self.link.receive(&mut self.buffer) else {
                return;
            };
            let Some(frame) = self.buffer.get(..length) else {
                return;
            };
            let counters = &self.context.counters;
            match Tag::of_answer(frame) {
                Some(Tag::Acyclic(number)) => self.acyclic.accept(number, frame, counters),
                Some(tag) => match &mut *self.context.cycle.borrow_mut() {
                    Some(cycle) => cycle.accept(tag, frame, &*self.link, counters),
                    None => counters.late.add(),
                },
                None => counters.foreign.add(),
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
        })
    }

    /// Polls futures, then sends what they queued. True if there may be more to do at once.
    fn acyclic_work(&mut self, until: Option<Duration>) -> bool {
        let mut polls = 0;
        let mut more = !self.acyclic.is_ahead();
        while more && polls < POLLS_PER_TURN {
            if polls % 8 == 7 && until.is_some_and(|until| self.link.now() >= until) {
                break;
            }
            more = self.tasks.poll_one();
            polls += 1;
        }
        // Futures may have been dropped above, and none will be before ethercrab's frames are sent.
        if self
            .acyclic
            .send(&mut *self.link, self.context.time.now(), until)
            .is_err()
        {
            self.context.counters.not_sent.add();
        }
        more
    }

    fn wait(&mut self, next: Option<Next>) {
        let now = self.link.now();
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
        let timeout = until.map_or(LONGEST_WAIT, |until| until.saturating_sub(now));
        if !timeout.is_zero() {
            self.link.wait(timeout.min(LONGEST_WAIT));
        }
    }
}

#[derive(Clone, Copy)]
struct Next {
    at: Duration,
    in_flight: bool,
}
