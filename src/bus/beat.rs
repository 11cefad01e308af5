//! The cycles, as the time that a program lives in.

use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
    time::Duration,
};

use super::{NetworkError, cycle::Stepper, drive_data::Drives};
use crate::wakes::{Waiters, Wakes};

/// All wait for the same.
const CYCLE: u32 = 0;

/// What the bus thread tells of each cycle.
#[derive(Debug)]
pub(super) struct Beat {
    ended_ns: AtomicU64,
    /// There are no more cycles.
    is_over: AtomicBool,
    waiters: Arc<Waiters>,
}

/// The end of whoever has the cycles: without it there are none any more.
pub(super) struct Beater(Arc<Beat>);

impl Beat {
    pub(super) fn new(wakes: &Wakes) -> Arc<Self> {
        Arc::new(Self {
            ended_ns: AtomicU64::new(0),
            is_over: AtomicBool::new(false),
            waiters: wakes.waiters(),
        })
    }

    pub(super) fn beater(self: &Arc<Self>) -> Beater {
        Beater(Arc::clone(self))
    }

    /// When the last cycle ended.
    pub(super) fn ended(&self) -> Duration {
        Duration::from_nanos(self.ended_ns.load(Ordering::Acquire))
    }
}

impl Drop for Beater {
    fn drop(&mut self) {
        self.0.is_over.store(true, Ordering::Release);
        self.0.waiters.announce(CYCLE);
    }
}

impl Stepper for Beater {
    fn before_send(&mut self, _: Duration, _: &mut Drives) {}

    /// To be called when everybody else has taken in what the cycle brought.
    fn after_receive(&mut self, now: Duration, _: &mut Drives) {
        let ns = u64::try_from(now.as_nanos()).unwrap_or(u64::MAX);
        self.0.ended_ns.store(ns, Ordering::Release);
        self.0.waiters.announce(CYCLE);
    }
}

/// The time of a network's cycles: by it a program waits for the next inputs, or for a while. From
/// [`Network::clock`](super::Network::clock); clones are the same clock.
///
/// On a real link it goes as every clock does. On a [`Wire`](crate::link::Wire) in virtual time it goes as fast as the loop is
/// turned, so that a test of a machine's pauses takes no time: see
/// [`BusLoop::run_until`](super::BusLoop::run_until).
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
    beat: Arc<Beat>,
}

impl CycleClock {
    pub(super) const fn new(beat: Arc<Beat>) -> Self {
        Self { beat }
    }

    /// When the last cycle ended, by the link's time: that of [`Link::now`](crate::link::Link::now), of the log and of the
    /// black boxes.
    #[must_use]
    pub fn now(&self) -> Duration {
        self.beat.ended()
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

    async fn until(&self, is_time: impl Fn(Duration) -> bool) -> Result<Duration, NetworkError> {
        let beat = &*self.beat;
        let shown = beat.waiters.until(CYCLE, || {
            // First this: the last cycle is one as well.
            let is_over = beat.is_over.load(Ordering::Acquire);
            let now = beat.ended();
            (is_time(now) || is_over).then_some(now)
        });
        let now = shown.await;
        if is_time(now) {
            return Ok(now);
        }
        Err(NetworkError::Thread("the network has ended".into()))
    }
}
