//! The one loop that everything on the bus goes through, and the acyclic requests: frames out and in, cycles on time, tasks between
//! them.
//!
//! The loop never blocks but in the link's `wait`, so that one lost frame holds nothing up. It takes its time from the link, so that tests
//! run it in virtual time without a thread.
//!
//! It owns the link, ethercrab's frames (`acyclic`), the tasks and their time (`executor`), and the accesses that every device has:
//! registers, AL state, SII, sync managers. It calls `cycle` once a turn. It must not know what a request is for: `line` and the rooms
//! behind it use a [`Context`] of it.

pub(super) mod acyclic;
pub(super) mod eeprom;
pub(super) mod executor;
pub(super) mod registers;
pub(super) mod sync_managers;

use std::{
    cell::{Cell, RefCell},
    future::Future,
    num::NonZero,
    pin::pin,
    rc::{Rc, Weak},
    sync::Arc,
    task::{self, Poll, Waker},
    thread,
    time::Duration,
};

use async_task::Task;
use ethercrab::{MainDevice, MainDeviceConfig, PduStorage, Timeouts};
use rustix::thread::set_current_timer_slack;
use smol::channel::{Sender, bounded};

use crate::{
    bus::{
        cycle::{
            AcyclicWindow, Cycle,
            frame::{self, Tag},
            statistics::Counters,
        },
        log::{Log, Writer},
        requests::{
            acyclic::Acyclic,
            executor::{Tasks, Time},
            registers::Registers,
        },
    },
    coe::{Emergencies, EmergencyQueue},
    link::{LONGEST_FRAME, Link, RawSocketError},
    wakes::{End, Wakes},
};

/// Frames of ethercrab's that can be on their way at once (a power of two; ethercrab takes 128 at most).
pub(in crate::bus) const SLOTS: usize = 64;
/// The longest data of a datagram that fits into an Ethernet frame, beside the frame's tag.
pub(in crate::bus) const LONGEST_DATAGRAM: u16 =
    (LONGEST_FRAME - frame::BEHIND_TAG - frame::DATAGRAM_OVERHEAD) as u16;
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
pub(in crate::bus) struct Context {
    pub registers: Registers,
    pub time: Rc<Time>,
    /// Weak, because its tasks hold contexts: with the loop they are all dropped, and nobody waits for them any more.
    tasks: Weak<Tasks>,
    pub cycle: Rc<RefCell<Option<Cycle>>>,
    pub counters: Arc<Counters>,
    pub log: Log,
    /// Who wakes the program's futures.
    pub wakes: Wakes,
    /// Those of all drives: where they go in, and where they come out.
    pub emergencies: (EmergencyQueue, Emergencies),
    /// Who waits for the link to be prepared.
    prepares: Rc<Cell<Option<Sender<LinkPrepared>>>>,
    over: Rc<Cell<bool>>,
}

type LinkPrepared = Result<(), RawSocketError>;

impl Context {
    /// Begins a task; none if the loop is gone.
    pub fn spawn<T: 'static>(&self, future: impl Future<Output = T> + 'static) -> Option<Task<T>> {
        Some(self.tasks.upgrade()?.spawn(future))
    }

    /// Has the link make ready for cycles, once there is nothing else to do. No request may be under way.
    pub async fn prepare_link(&self) -> LinkPrepared {
        let (prepared, result) = bounded(1);
        self.prepares.set(Some(prepared));
        // Without a loop there is no link.
        result.recv().await.unwrap_or(Ok(()))
    }

    /// Ends the loop after this turn.
    pub fn end(&self) {
        self.over.set(true);
    }
}

/// The loop and what it owns.
pub(in crate::bus) struct Reactor {
    link: Box<dyn Link>,
    acyclic: Acyclic,
    tasks: Rc<Tasks>,
    context: Context,
    wait_strategy: WaitStrategy,
    buffer: Vec<u8>,
}

impl Reactor {
    /// Makes the storage that ethercrab needs, which stays as long as the process.
    pub fn new(
        link: Box<dyn Link>,
        wait_strategy: WaitStrategy,
        counters: &Arc<Counters>,
        wakes: &Wakes,
        log: Log,
    ) -> Self {
        type Storage = PduStorage<SLOTS, { PduStorage::element_size(LONGEST_DATAGRAM as usize) }>;
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
                counters: Arc::clone(counters),
                log,
                emergencies: EmergencyQueue::new(EMERGENCIES, wakes.waiters()),
                wakes: wakes.clone(),
                prepares: Rc::default(),
                over: Rc::default(),
            },
            tasks,
            wait_strategy,
            buffer: vec![0; LONGEST_FRAME],
        }
    }

    pub fn now(&self) -> Duration {
        self.link.now()
    }

    pub fn wakes(&self) -> &Wakes {
        &self.context.wakes
    }

    pub fn context(&self) -> &Context {
        &self.context
    }

    /// Ends all that futures of the program may wait for, though the loop is kept.
    fn end(&mut self) {
        self.tasks = Rc::new(Tasks::new());
        self.context.emergencies = EmergencyQueue::new(1, self.context.wakes.waiters());
    }

    /// One turn. False once the loop is over.
    pub fn turn(&mut self) -> bool {
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
            busy = self.acyclic_work(next.map(|next| next.window));
            self.context.log.hand_over();
            self.context.wakes.hand_over();
        }
        if !busy {
            match self.context.prepares.take() {
                // Nobody takes it when the program has given up meanwhile.
                Some(prepared) => drop(prepared.try_send(self.link.prepare())),
                None => self.wait(now, next),
            }
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
    fn exchange(&mut self, now: Duration) -> Option<NextCycle> {
        let mut cycle = self.context.cycle.borrow_mut();
        let cycle = cycle.as_mut()?;
        cycle.turn(now, &mut *self.link, &self.context.counters);
        Some(NextCycle {
            at: cycle.next(),
            in_flight: cycle.in_flight(),
            sent: cycle.sent(),
            window: cycle.window(),
        })
    }

    /// Polls futures, then sends what they queued. True if there may be more to do at once.
    fn acyclic_work(&mut self, window: Option<AcyclicWindow>) -> bool {
        if self.acyclic.has_work(self.context.time.now()) && !self.send_acyclic(window) {
            // What futures would ask for now had to wait behind that.
            return false;
        }
        let mut polls = 0;
        let mut more = !self.acyclic.is_ahead();
        while more && polls < POLLS_PER_TURN {
            if polls % 8 == 7 && window.is_some_and(|window| self.link.now() >= window.end) {
                break;
            }
            more = self.tasks.poll_one();
            polls += usize::from(more);
        }
        // Futures may have been dropped above, and none will be before ethercrab's frames are sent.
        if polls > 0 {
            more &= self.send_acyclic(window);
        }
        more
    }

    /// False while frames wait for room.
    fn send_acyclic(&mut self, window: Option<AcyclicWindow>) -> bool {
        let counters = &self.context.counters;
        self.acyclic.send(&mut *self.link, window, counters)
    }

    /// `now` is when the turn began: what has become due since then ends the sleep at once.
    fn wait(&mut self, now: Duration, next: Option<NextCycle>) {
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
        match self.wait_strategy.sleep(now, until, awaited) {
            None => self.link.pause(),
            Some(until) => self.link.wait(until),
        }
    }
}

#[derive(Clone, Copy)]
struct NextCycle {
    at: Duration,
    in_flight: bool,
    sent: Duration,
    window: AcyclicWindow,
}

// Whether the bus thread sleeps or spins while it waits.

/// How long before a cycle, and for its frames, the thread spins where the machine is suited to it.
const SPIN: Duration = Duration::from_micros(50);
/// Cycles that are longer gain nothing that counts.
const LONGEST_PERIOD_TO_SPIN: Duration = Duration::from_micros(500);
/// With fewer cores spinning takes the time from the program, or from the kernel's own work for the interface.
const FEWEST_CORES_TO_SPIN: usize = 4;

/// How the bus thread waits for the frames of a cycle and for the start of the next one. While the line is brought up it sleeps.
///
/// A thread that sleeps is woken some 10 to 50 µs after its time or its frame; one that spins sees both within a microsecond, and
/// takes a processor core for itself meanwhile. Without a [real-time class](crate::bus::RealTime) the kernel lets another thread on that
/// core when it has spun for a while, and then the cycle is late by milliseconds: [`Spin`](Self::Spin) wants a core that nobody else
/// uses.
///
/// ```
/// use servocrab::{Network, bus::WaitStrategy};
/// use std::time::Duration;
/// let builder = Network::builder()
///     .cycle(Duration::from_micros(250))
///     .wait_strategy(WaitStrategy::SpinThenBlock { spin: Duration::from_micros(30) });
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum WaitStrategy {
    /// Sleeps whenever there is nothing to do.
    Block,
    /// Never sleeps.
    Spin,
    /// Sleeps until `spin` before a cycle, and spins for `spin` after its frames were sent: what takes longer is slept for.
    SpinThenBlock {
        /// How long it spins, each time.
        spin: Duration,
    },
}

impl WaitStrategy {
    /// What is taken where the program says nothing: [`SpinThenBlock`](Self::SpinThenBlock) with 50 µs, but not more than an eighth
    /// of the cycle, where cycles are at most 500 µs long and the process may use four cores or more; else [`Block`](Self::Block).
    ///
    /// ```
    /// use servocrab::bus::WaitStrategy;
    /// use std::time::Duration;
    /// assert_eq!(WaitStrategy::suited_to(Duration::from_millis(1), 8), WaitStrategy::Block);
    /// ```
    #[must_use]
    pub fn suited_to(period: Duration, cores: usize) -> Self {
        if period > LONGEST_PERIOD_TO_SPIN || cores < FEWEST_CORES_TO_SPIN {
            return Self::Block;
        }
        Self::SpinThenBlock {
            spin: SPIN.min(period / 8),
        }
    }

    /// The same for this machine.
    pub(in crate::bus) fn suited_here(period: Duration) -> Self {
        let cores = thread::available_parallelism().map_or(1, NonZero::get);
        Self::suited_to(period, cores)
    }

    /// Until when the thread may sleep now, where nothing is to be done before `until`; none where it is to spin.
    pub(in crate::bus) fn sleep(
        self,
        now: Duration,
        until: Duration,
        awaited: Awaited,
    ) -> Option<Duration> {
        let until = match (self, awaited) {
            (Self::Block, _) | (_, Awaited::Nothing) => until,
            (Self::Spin, _) => return None,
            (Self::SpinThenBlock { spin }, Awaited::Frames { sent }) => {
                if now < sent.saturating_add(spin) {
                    return None;
                }
                until
            }
            (Self::SpinThenBlock { spin }, Awaited::Cycle { start }) => {
                until.min(start.saturating_sub(spin))
            }
        };
        (now < until).then_some(until)
    }
}

/// Has the kernel wake this thread when its time has come, and not up to 50 µs later together with others (prctl(2),
/// `PR_SET_TIMERSLACK`).
pub(in crate::bus) fn wake_on_time() {
    // Where that is refused it sleeps as others do.
    let _ = set_current_timer_slack(Some(NonZero::<u64>::MIN));
}

/// What the thread waits for.
#[derive(Debug, Clone, Copy)]
pub(in crate::bus) enum Awaited {
    /// There are no cycles.
    Nothing,
    /// The frames of a cycle, which were sent at this time.
    Frames { sent: Duration },
    /// The next cycle, which starts at this time.
    Cycle { start: Duration },
}

// The loop of a network, turn by turn.

/// The loop of a network: everything on the bus happens in its turns.
pub struct BusLoop {
    reactor: Reactor,
    /// None in virtual time, and once the network has ended.
    writer: Option<Writer>,
    /// Dropped at the end, which is what `Network::shutdown` waits for.
    alive: Option<Sender<()>>,
    wakes: Wakes,
    /// Last: what the fields before it ring for is woken by it.
    _wakes_end: End,
}

impl BusLoop {
    pub(in crate::bus) fn new(
        reactor: Reactor,
        writer: Option<Writer>,
        alive: Sender<()>,
        wakes_end: End,
    ) -> Self {
        Self {
            wakes: reactor.wakes().clone(),
            reactor,
            writer,
            alive: Some(alive),
            _wakes_end: wakes_end,
        }
    }

    /// One turn: frames, a cycle if it is time, acyclic work in the window, and a wait until there is more to do. False
    /// once the network has ended.
    #[must_use = "the loop is over when this is false"]
    pub fn turn(&mut self) -> bool {
        if self.alive.is_none() {
            return false;
        }
        let goes_on = self.reactor.turn();
        if !goes_on {
            if let Some(writer) = self.writer.take() {
                writer.end();
            }
            self.reactor.end();
            self.alive = None;
            self.wakes.hand_over();
        }
        goes_on
    }

    /// The link's time.
    #[must_use]
    pub fn now(&self) -> Duration {
        self.reactor.now()
    }

    /// Turns until the network has ended.
    pub fn run(mut self) {
        while self.turn() {}
    }

    /// Turns until `future` is done, whose value it gives. That is how a machine's own logic is tested: on a
    /// [`Wire`](crate::link::Wire) in virtual time, to a simulated segment, the drives move as they do and nobody waits for
    /// it: a minute there takes a fraction of a second here.
    ///
    /// Pauses of the machine belong to the cycles' clock ([`Network::clock`](crate::Network::clock)), which goes with the
    /// loop, and so do [`Done::within`](crate::profile_position::Done::within) and [`Home::within`](crate::homing::Home::within). A
    /// timer of an executor goes by the clock on the wall: while such a one is waited for, virtual time runs away.
    ///
    /// ```
    /// # fn main() -> Result<(), Box<dyn std::error::Error>> {
    /// use std::time::Duration;
    /// use servocrab::{Axis, AxisConfig, DriveConfig, Network, Referencing, bus::CycleClock, drives, link::Wire};
    /// use servocrab::SetPoint;
    /// use servocrab_sim::{Segment, personality};
    ///
    /// // What is tested.
    /// async fn stroke(ram: &Axis, clock: &CycleClock) -> Result<(), Box<dyn std::error::Error>> {
    ///     let positions = ram.profile_position().await?;
    ///     let slowly = SetPoint::new().velocity(10_000);
    ///     positions.move_abs(100_000, slowly).await?.done().await?;
    ///     clock.sleep(Duration::from_secs(60)).await?; // it presses
    ///     positions.move_abs(0, slowly).await?.done().await?;
    ///     Ok(())
    /// }
    ///
    /// let mut segment = Segment::new().with(personality::generic());
    /// let wire = Wire::in_virtual_time(Duration::from_micros(20), move |frame, now| segment.process(frame, now));
    /// let drive = DriveConfig::new(drives::generic()).axis(AxisConfig::new("ram").referencing(Referencing::AbsoluteEncoder));
    /// let (starting, mut bus) = Network::builder().link(wire).drive(0, drive).split()?;
    /// bus.run_until(async {
    ///     let net = starting.network().await?;
    ///     let (ram, clock) = (net.axis("ram")?, net.clock());
    ///     ram.enable().await?;
    ///     let before = clock.now();
    ///     stroke(&ram, &clock).await?;
    ///     let took = clock.now() - before;
    ///     assert!((80..81).contains(&took.as_secs()), "{took:?}");
    ///     assert!(ram.status().position.abs() < 10);
    ///     net.shutdown().await?;
    ///     Ok(())
    /// })
    /// # }
    /// ```
    ///
    /// Once the network has ended there are no more turns, and `future` is polled without them.
    pub fn run_until<T>(&mut self, future: impl Future<Output = T>) -> T {
        let mut future = pin!(future);
        loop {
            // What it waits for comes with a turn, so that nobody has to wake it.
            let polled = future
                .as_mut()
                .poll(&mut task::Context::from_waker(Waker::noop()));
            if let Poll::Ready(value) = polled {
                return value;
            }
            if !self.turn() {
                std::thread::yield_now();
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::{Awaited, WaitStrategy};

    const fn us(us: u64) -> Duration {
        Duration::from_micros(us)
    }

    #[test]
    fn short_cycles_on_many_cores_spin_for_a_part_of_the_cycle_and_all_others_sleep() {
        assert_eq!(WaitStrategy::suited_to(us(1000), 64), WaitStrategy::Block);
        assert_eq!(WaitStrategy::suited_to(us(250), 2), WaitStrategy::Block);
        let spins = |spin| WaitStrategy::SpinThenBlock { spin: us(spin) };
        assert_eq!(WaitStrategy::suited_to(us(500), 4), spins(50));
        assert_eq!(WaitStrategy::suited_to(us(200), 4), spins(25));
    }

    #[test]
    fn a_thread_spins_before_a_cycle_and_after_its_frames_and_sleeps_between() {
        let wait_strategy = WaitStrategy::SpinThenBlock { spin: us(30) };
        let frames = Awaited::Frames { sent: us(100) };
        assert_eq!(wait_strategy.sleep(us(129), us(829), frames), None);
        assert_eq!(wait_strategy.sleep(us(130), us(830), frames), Some(us(830)));
        let cycle = Awaited::Cycle { start: us(1000) };
        assert_eq!(wait_strategy.sleep(us(400), us(1000), cycle), Some(us(970)));
        let timer = wait_strategy.sleep(us(400), us(490), cycle);
        assert_eq!(timer, Some(us(490)));
        assert_eq!(wait_strategy.sleep(us(970), us(1000), cycle), None);
    }

    #[test]
    fn nobody_spins_while_there_are_no_cycles() {
        let sleep = WaitStrategy::Spin.sleep(us(5), us(705), Awaited::Nothing);
        assert_eq!(sleep, Some(us(705)));
    }
}
