//! The loop of a network, turn by turn.

use std::{
    pin::pin,
    task::{Context, Poll, Waker},
    time::Duration,
};

use smol::channel::Sender;

use super::{log::Writer, reactor::Reactor};
use crate::wakes::{End, Wakes};

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
    pub(super) fn new(
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

    /// One turn: frames, a cycle if it is time, acyclic work in the gap, and a wait until there is more to do. False
    /// once the network has ended.
    #[must_use = "the loop is over when this is false"]
    pub fn turn(&mut self) -> bool {
        let goes_on = self.reactor.turn();
        if !goes_on {
            if let Some(writer) = self.writer.take() {
                writer.end();
            }
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
    /// Pauses of the machine belong to the cycles' clock ([`Network::clock`](super::Network::clock)), which goes with the
    /// loop. A timer of an executor goes by the clock on the wall, and so do [`Done::within`](crate::profile_position::Done::within) and
    /// [`Home::within`](crate::homing::Home::within): while such a one is waited for, virtual time runs away.
    ///
    /// ```
    /// # fn main() -> Result<(), Box<dyn std::error::Error>> {
    /// use std::time::Duration;
    /// use servocrab::{axis::{Axis, Referencing}, bus::{CycleClock, DriveConfig, Network}, drives, link::Wire};
    /// use servocrab::profile_position::SetPoint;
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
    /// let drive = DriveConfig::new(drives::generic()).axis("ram").referencing("ram", Referencing::AbsoluteEncoder);
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
                .poll(&mut Context::from_waker(Waker::noop()));
            if let Poll::Ready(value) = polled {
                return value;
            }
            if !self.turn() {
                std::thread::yield_now();
            }
        }
    }
}
