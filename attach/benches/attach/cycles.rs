//! What is counted: the cycles of the line in virtual time, with the server and its clients as threads beside them.

use std::{
    process,
    thread::{self, sleep},
    time::Duration,
};

use servocrab::{Network, bus::BusLoop, link::Wire};
use servocrab_attach::{Attach, serve};

use crate::{
    Result, Running, TURNS,
    counted::{Outside, counted, until},
    line, signals,
};

/// Cycles of each of the turns.
pub(crate) const COUNTED: u64 = 100;
/// Clients have begun by then.
const SETTLING: u64 = 50;
/// So long clients have for each cycle.
const BETWEEN: Duration = Duration::from_millis(5);

pub(crate) fn live() -> Result<()> {
    let (mut segment, builder) = line();
    let wire = Wire::in_virtual_time(Duration::from_micros(10), move |frame: &mut [u8], now| {
        segment.process(frame, now)
    });
    let (starting, mut bus) = builder.link(Outside(wire)).split()?;
    let net = until(&mut bus, starting.network())?;
    let directory = tempfile::tempdir()?;
    let attach = Attach::new("counted").directory(directory.path().join("servocrab"));
    let attached = serve(&net, attach)?;
    let signals = signals()?;
    // Longer than standstill takes to show.
    cycles(&net, &mut bus, 200);
    for (_, clients) in TURNS {
        let (socket, signals) = (attached.socket().to_owned(), signals.clone());
        let start = move || Running::start(&socket, &signals, clients);
        let running = meanwhile(&net, &mut bus, move || {
            start().map_err(|error| error.to_string())
        })?;
        cycles(&net, &mut bus, SETTLING);
        counted(|| cycles(&net, &mut bus, COUNTED));
        // A client ends with a cycle that it reads.
        let lost = meanwhile(&net, &mut bus, || running.end());
        if lost != 0 {
            return Err(format!("{lost} cycles were lost: the clients did not read").into());
        }
    }
    // The line ends with the program.
    process::exit(0)
}

/// Does this on a thread of its own while the line runs.
fn meanwhile<T: Send + 'static>(
    net: &Network,
    bus: &mut BusLoop,
    of: impl FnOnce() -> T + Send + 'static,
) -> T {
    let thread = thread::spawn(of);
    while !thread.is_finished() {
        cycles(net, bus, 1);
    }
    thread.join().expect("it does not panic")
}

/// Whole cycles, from the sending of one to that of another.
fn cycles(net: &Network, bus: &mut BusLoop, cycles: u64) {
    for _ in 0..cycles {
        let before = net.statistics().cycles;
        while net.statistics().cycles == before {
            assert!(bus.turn(), "the loop has ended");
        }
        sleep(BETWEEN);
    }
}
