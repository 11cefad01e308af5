//! The cyclic exchange of process data: when cycles begin and end, and who is called around them.
//!
//! It owns the frames of the process data (`frame`), what each device gets and gives (`exchange`), the phase against a
//! reference clock (`reference_clock`), the counters (`statistics`) and the last cycles of every axis (`black_box`). Time is an
//! argument, and the link is only sent to. It knows no tasks, no registers and no devices beyond their share of the frames: it must not
//! call `requests` or any room above that.

pub(super) mod black_box;
pub(super) mod exchange;
pub(super) mod frame;
pub(super) mod reference_clock;
pub(super) mod statistics;

use std::{
    future::Future,
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
    time::Duration,
};

use crate::{
    bus::{
        cable::receive_deadline,
        cycle::{
            exchange::{Drives, Events, Exchange},
            frame::Tag,
            reference_clock::Phase,
            statistics::Counters,
        },
        error::{NetworkError, ReferenceClock},
    },
    link::Link,
    wakes::{Waiters, Wakes},
};

/// Who works with the process data, on the bus thread.
pub(in crate::bus) trait Stepper {
    /// Last thing before the outputs are sent.
    fn before_send(&mut self, now: Duration, drives: &mut Drives);
    /// After the inputs came in, or did not.
    fn after_receive(&mut self, now: Duration, drives: &mut Drives);
}

/// One, then the other.
impl<A: Stepper, B: Stepper> Stepper for (A, B) {
    fn before_send(&mut self, now: Duration, drives: &mut Drives) {
        self.0.before_send(now, drives);
        self.1.before_send(now, drives);
    }

    fn after_receive(&mut self, now: Duration, drives: &mut Drives) {
        self.0.after_receive(now, drives);
        self.1.after_receive(now, drives);
    }
}

/// The exchange in time.
pub(in crate::bus) struct Cycle {
    pub exchange: Exchange,
    stepper: Box<dyn Stepper>,
    /// Keeps the cycles in step with a reference clock.
    clock: Option<Phase>,
    period: Duration,
    /// Parts of it: divisions are dear.
    deadline: Duration,
    eighth: Duration,
    next_start: Duration,
    receive_until: Duration,
    /// When the frames of the last cycle were sent, and when the last of them came back, if all did.
    sent_at: Duration,
    back_at: Option<Duration>,
    /// How long they were away, where that is still to be counted.
    took: Option<Duration>,
    round_trip: RoundTrip,
    /// Whether the frames of the last cycle were all back before its deadline.
    all_back: bool,
    /// Consecutive cycles in which everything was right.
    pub good: u32,
    /// What the last cycle showed.
    pub last: Events,
    /// Whether a drive was lost or came back since somebody looked.
    pub membership_changed: bool,
}

impl Cycle {
    pub fn new(
        exchange: Exchange,
        stepper: Box<dyn Stepper>,
        period: Duration,
        first: Duration,
        clock: Option<Phase>,
    ) -> Self {
        Self {
            exchange,
            stepper,
            clock,
            period,
            deadline: receive_deadline(period),
            eighth: period / 8,
            next_start: first,
            receive_until: first,
            sent_at: first,
            back_at: None,
            took: None,
            round_trip: RoundTrip::default(),
            all_back: false,
            good: 0,
            last: Events::default(),
            membership_changed: false,
        }
    }

    pub const fn in_flight(&self) -> bool {
        self.exchange.in_flight()
    }

    /// When the last cycle was sent.
    pub const fn sent(&self) -> Duration {
        self.sent_at
    }

    /// Whether a cycle is to be sent now, and nothing else before.
    pub fn is_due(&self, now: Duration) -> bool {
        !self.in_flight() && now >= self.next_start
    }

    /// The time for acyclic frames until the next cycle starts.
    pub fn window(&self) -> AcyclicWindow {
        AcyclicWindow {
            end: self.next_start,
            round_trip: self.round_trip.reckoned(self.eighth),
            longest_alone: self.eighth,
        }
    }

    /// When [`turn`](Self::turn) is to be called at the latest. For a frame that is lost when all was well before that is the next
    /// start: the time that the thread is woken at in any case, so that it sets its timer once a cycle and not twice.
    pub const fn next(&self) -> Duration {
        if self.in_flight() && !self.all_back {
            self.receive_until
        } else {
            self.next_start
        }
    }

    /// Takes a frame of process data in a turn that began at `now`. True once all of the cycle are there: it ends with the turn that
    /// received the last one.
    // This and `turn` are kept whole: `benches/step` counts what is done in them, by their names.
    #[inline(never)]
    pub fn accept(&mut self, tag: Tag, frame: &[u8], now: Duration, counters: &Counters) -> bool {
        let complete = self.exchange.accept(tag, frame, counters);
        if complete {
            self.back_at = Some(now);
            self.receive_until = Duration::ZERO;
        } else if let Some(cycles) = self.exchange.take_late() {
            let since = now.saturating_sub(self.sent_at);
            counters.came_late(since.saturating_add(self.period.saturating_mul(cycles)));
        }
        complete
    }

    /// Ends a cycle and begins the next, each when it is time.
    #[inline(never)]
    pub fn turn(&mut self, now: Duration, link: &mut dyn Link, counters: &Counters) {
        if self.in_flight() && now >= self.receive_until {
            self.end(now, counters);
        }
        if self.is_due(now) {
            self.begin(now, link, counters);
        }
    }

    fn begin(&mut self, now: Duration, link: &mut dyn Link, counters: &Counters) {
        let late = now.saturating_sub(self.next_start);
        // Cycles that were slept through are not made up for, and the phase stays.
        let periods = if late < self.period {
            1
        } else {
            let slept_through = late.as_nanos() / self.period.as_nanos().max(1);
            u32::try_from(slept_through + 1).unwrap_or(u32::MAX)
        };
        if let Some(clock) = &mut self.clock {
            let (passes, sooner) = clock.begin(late, periods);
            self.exchange.set_reference_time(passes as u32);
            self.next_start = earlier(self.next_start, sooner);
        }
        self.stepper.before_send(now, &mut self.exchange.drives);
        self.exchange.send(link, counters);
        self.sent_at = now;
        self.receive_until = now.saturating_add(self.deadline);
        let later = self.period.saturating_mul(periods);
        self.next_start = self.next_start.saturating_add(later);
        // The books are kept while nothing waits for it.
        self.exchange.record(now, late);
        counters.lateness.record(late);
        if late > self.period / 2 {
            counters.late_cycles.add();
        }
        if periods > 1 {
            counters.overruns.add_many(u64::from(periods - 1));
        }
        if let Some(took) = self.took.take() {
            counters.round_trip.record(took);
        }
    }

    /// The reference clock's time, and when it was that, where cycles are in step with one.
    pub fn reference_time(&self) -> Option<(u64, Duration)> {
        let clock = self.clock.as_ref()?;
        Some((clock.time(), self.sent_at))
    }

    fn end(&mut self, now: Duration, counters: &Counters) {
        let events = self.exchange.judge(counters);
        self.all_back = false;
        if let Some(back) = self.back_at.take() {
            let took = back.saturating_sub(self.sent_at);
            self.all_back = took <= self.deadline;
            self.round_trip.observe(took);
            self.took = Some(took);
        }
        let complete = !events.wrong && events.al_status.is_some();
        self.good = if complete {
            self.good.saturating_add(1)
        } else {
            0
        };
        self.membership_changed |= events.membership;
        self.last = events;
        if let Some(clock) = &mut self.clock {
            let (sooner, measured) = clock.end(events.reference_time);
            self.next_start = earlier(self.next_start, sooner);
            match measured {
                Some(measured) => counters.clock.record(&measured),
                None => counters.clock.hold(clock.is_locked(), clock.reference()),
            }
            if clock.reference() == ReferenceClock::Jumped {
                self.exchange.lead_clocks();
            }
        }
        self.stepper.after_receive(now, &mut self.exchange.drives);
    }
}

/// So many nanoseconds before, or after with a negative number.
fn earlier(time: Duration, sooner: i64) -> Duration {
    let by = Duration::from_nanos(sooner.unsigned_abs());
    if sooner < 0 {
        time.saturating_add(by)
    } else {
        time.saturating_sub(by)
    }
}

// The time between the end of a cycle and the start of the next one, in which acyclic frames may be on their way.

/// The acyclic window, as seen from within it.
#[derive(Debug, Clone, Copy)]
pub(in crate::bus) struct AcyclicWindow {
    /// When the next cycle starts.
    pub end: Duration,
    /// How long a frame is away, as measured.
    pub round_trip: Duration,
    /// What a frame alone on the wire is reckoned with at the most: the longest ones would never go between short cycles.
    pub longest_alone: Duration,
}

impl AcyclicWindow {
    /// Whether a frame that is sent now is back before the window ends, when the wire is busy until then and takes this long for it.
    pub fn has_room(&self, now: Duration, busy_until: Duration, takes: Duration) -> bool {
        let takes = if busy_until <= now {
            takes.min(self.longest_alone)
        } else {
            takes
        };
        busy_until.max(now) + takes + self.round_trip <= self.end
    }
}

/// How long frames are away: the longest of late.
#[derive(Debug, Clone, Copy, Default)]
struct RoundTrip(Duration);

impl RoundTrip {
    /// Takes in what the frames of one cycle took. A long one counts for some hundred cycles.
    pub fn observe(&mut self, took: Duration) {
        self.0 = took.max(self.0 - self.0 / 64);
    }

    /// What is reckoned with. Not more than the end of every cycle leaves, an eighth of the period, so that mailboxes are served
    /// whatever was measured: a frame that is late then is counted.
    pub fn reckoned(self, eighth: Duration) -> Duration {
        self.0.min(eighth)
    }
}

// The cycles, as a program's time.

/// All wait for the same.
const CYCLE: u32 = 0;

/// What the bus thread reports of each cycle.
#[derive(Debug)]
pub(in crate::bus) struct CycleTick {
    ended_ns: AtomicU64,
    /// There are no more cycles.
    is_over: AtomicBool,
    waiters: Arc<Waiters>,
}

/// The end of whoever has the cycles: without it there are none any more.
pub(in crate::bus) struct TickSource(Arc<CycleTick>);

impl CycleTick {
    pub fn new(wakes: &Wakes) -> Arc<Self> {
        Arc::new(Self {
            ended_ns: AtomicU64::new(0),
            is_over: AtomicBool::new(false),
            waiters: wakes.waiters(),
        })
    }

    pub fn source(self: &Arc<Self>) -> TickSource {
        TickSource(Arc::clone(self))
    }

    /// When the last cycle ended.
    pub fn ended(&self) -> Duration {
        Duration::from_nanos(self.ended_ns.load(Ordering::Acquire))
    }
}

impl Drop for TickSource {
    fn drop(&mut self) {
        self.0.is_over.store(true, Ordering::Release);
        self.0.waiters.announce(CYCLE);
    }
}

impl Stepper for TickSource {
    fn before_send(&mut self, _: Duration, _: &mut Drives) {}

    /// To be called when everybody else has taken in what the cycle brought.
    fn after_receive(&mut self, now: Duration, _: &mut Drives) {
        let ns = u64::try_from(now.as_nanos()).unwrap_or(u64::MAX);
        self.0.ended_ns.store(ns, Ordering::Release);
        self.0.waiters.announce(CYCLE);
    }
}

/// The time of a network's cycles: by it a program waits for the next inputs, or for a while. From
/// [`Network::clock`](crate::bus::Network::clock); clones are the same clock.
///
/// On a real link it goes as every clock does. On a [`Wire`](crate::link::Wire) in virtual time it goes as fast as the loop is
/// turned, so that a test of a machine's pauses takes no time: see
/// [`BusLoop::run_until`](crate::bus::BusLoop::run_until).
///
/// ```
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// # use servocrab::{bus::{Expected, IoConfig, Network}, link::Wire};
/// # use servocrab_sim::{Segment, personality};
/// # let mut terminal = personality::digital_inputs();
/// # terminal.set_inputs(&[1]);
/// # let mut segment = Segment::new().with(terminal).with(personality::digital_outputs());
/// # let wire = Wire::new(move |frame, now| segment.process(frame, now));
/// # smol::block_on(async {
/// # let net = Network::builder().link(wire)
/// #     .io(0, IoConfig::new("buttons", Expected::new(0, 0x4449_3038)))
/// #     .io(1, IoConfig::new("valves", Expected::new(0, 0x444F_3038))).start().await?;
/// use std::time::Duration;
/// let clock = net.clock();
/// let start = net.io("buttons")?.input::<bool>("Channel 1.Input")?;
/// let gripper = net.io("valves")?.output::<bool>("Channel 3.Output")?;
/// while start.get() != Ok(true) {
///     clock.next_cycle().await?; // looks at every cycle's inputs once
/// }
/// gripper.set(true);
/// clock.sleep(Duration::from_millis(30)).await?; // until it has closed
/// # net.shutdown().await?;
/// # Ok(())
/// # })
/// # }
/// ```
#[derive(Debug, Clone)]
pub struct CycleClock {
    tick: Arc<CycleTick>,
}

impl CycleClock {
    pub(in crate::bus) const fn new(tick: Arc<CycleTick>) -> Self {
        Self { tick }
    }

    /// When the last cycle ended, by the link's time: that of [`Link::now`](crate::link::Link::now), of the log and of the
    /// black boxes.
    #[must_use]
    pub fn now(&self) -> Duration {
        self.tick.ended()
    }

    /// Waits for the end of the next cycle, with what it brought, or did not, and gives its time.
    ///
    /// # Errors
    /// [`NetworkError::Thread`] once the network has ended.
    pub async fn next_cycle(&self) -> Result<Duration, NetworkError> {
        let last = self.now();
        self.until(|now| now > last).await
    }

    /// Waits for the first cycle that ends this much later than the last one did, or more.
    ///
    /// # Errors
    /// [`NetworkError::Thread`] once the network has ended.
    pub async fn sleep(&self, duration: Duration) -> Result<(), NetworkError> {
        let until = self.now().saturating_add(duration);
        self.until(|now| now >= until).await.map(drop)
    }

    /// Waits for this, and no longer than so much of the network's time. None where that was over first: what was waited for is dropped
    /// then. In virtual time nothing depends on a clock of the computer.
    ///
    /// ```
    /// # fn main() -> Result<(), Box<dyn std::error::Error>> {
    /// # use servocrab::{bus::{DriveConfig, Network}, drives, link::Wire};
    /// # let mut segment = servocrab_sim::Segment::new().with(servocrab_sim::personality::akd2g());
    /// # let wire = Wire::new(move |frame, now| segment.process(frame, now));
    /// # let drive = DriveConfig::new(drives::akd2g()).axis("x");
    /// # smol::block_on(async {
    /// # let net = Network::builder().link(wire).drive(0, drive).start().await?;
    /// use std::time::Duration;
    /// let emergencies = net.all_emergencies();
    /// let quiet = net.clock().timeout(Duration::from_millis(20), emergencies.next()).await?;
    /// assert!(quiet.is_none(), "no drive has said anything");
    /// # net.shutdown().await?;
    /// # Ok(())
    /// # })
    /// # }
    /// ```
    ///
    /// # Errors
    /// [`NetworkError::Thread`] once the network has ended.
    pub async fn timeout<T>(
        &self,
        limit: Duration,
        future: impl Future<Output = T>,
    ) -> Result<Option<T>, NetworkError> {
        let done = async { Ok(Some(future.await)) };
        let late = async { self.sleep(limit).await.map(|()| None) };
        smol::future::or(done, late).await
    }

    async fn until(&self, is_time: impl Fn(Duration) -> bool) -> Result<Duration, NetworkError> {
        let tick = &*self.tick;
        let shown = tick.waiters.until(CYCLE, || {
            // First this: the last cycle is one as well.
            let is_over = tick.is_over.load(Ordering::Acquire);
            let now = tick.ended();
            (is_time(now) || is_over).then_some(now)
        });
        let now = shown.await;
        if is_time(now) {
            return Ok(now);
        }
        Err(NetworkError::Thread("the network has ended".into()))
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::{AcyclicWindow, RoundTrip};
    use crate::bus::cable::time_on_cable;

    const fn us(us: u64) -> Duration {
        Duration::from_micros(us)
    }

    #[test]
    fn a_frame_has_room_when_it_is_back_before_the_next_cycle() {
        let window = AcyclicWindow {
            end: us(1000),
            round_trip: us(50),
            longest_alone: us(125),
        };
        // 84 bytes with all that is around the shortest frame: 6.72 µs.
        assert!(window.has_room(us(943), us(0), time_on_cable(14)));
        assert!(!window.has_room(us(944), us(0), time_on_cable(60)));
        // 1538 bytes with all that is around the longest one: 123.04 µs.
        assert!(window.has_room(us(826), us(0), time_on_cable(1514)));
        assert!(!window.has_room(us(827), us(0), time_on_cable(1514)));
        assert!(!window.has_room(us(820), us(828), time_on_cable(1514)));
    }

    #[test]
    fn between_cycles_shorter_than_a_frame_one_goes_alone() {
        let window = AcyclicWindow {
            end: us(100),
            round_trip: us(12),
            longest_alone: us(12),
        };
        assert!(window.has_room(us(50), us(0), time_on_cable(1514)));
        assert!(!window.has_room(us(50), us(57), time_on_cable(1514)));
        assert!(!window.has_room(us(80), us(0), time_on_cable(1514)));
    }

    #[test]
    fn a_long_round_trip_is_reckoned_with_for_a_while_and_never_with_more_than_is_left_of_every_cycle()
     {
        let mut round_trip = RoundTrip::default();
        round_trip.observe(us(80));
        round_trip.observe(us(20));
        assert!(round_trip.reckoned(us(125)) > us(75));
        for _ in 0..300 {
            round_trip.observe(us(20));
        }
        assert_eq!(round_trip.reckoned(us(125)), us(20));
        round_trip.observe(us(700));
        assert_eq!(round_trip.reckoned(us(125)), us(125));
    }
}
