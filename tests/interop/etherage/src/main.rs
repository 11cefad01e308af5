//! Runs the etherage master against one simulated drive: `servocrab-interop-etherage INTERFACE TABLE DRIVE`.
//!
//! Each check prints a line `ok NAME: what was seen`; the first that fails ends the program. What a drive should answer is
//! in the table (`drives.json`); the program has no case for any of them. It shares no code or constants with the library
//! under test or with the simulated drive.

mod acyclic;
mod cyclic;
mod drive;

use std::{env, error::Error, fmt, fmt::Debug, fs, panic, process, sync::Arc, time::Duration};

use cyclic::Bench;
use drive::Drive;
use etherage::{
    CommunicationState, EthernetSocket, Master, RawMaster, Slave,
    clock::DistributedClock,
    data::Field as Place,
    mapping::{Config, Mapping},
};
use tokio::time;

/// Readings by which etherage sets the clock's offset; by default it takes 15000.
const CLOCK_SAMPLES: usize = 500;
const SYNC0: Duration = Duration::from_millis(2);
/// Later than the set-up takes, and not so late that OP is refused for want of a pulse.
const SYNC0_AHEAD: Duration = Duration::from_millis(150);

/// Exit code when etherage itself gave up, as it does where a frame takes longer than 100 ms.
const COULD_NOT_SAY: u8 = 2;

type Outcome<T = ()> = Result<T, Box<dyn Error>>;

/// For anything at all; nothing in etherage gives up by itself.
const PATIENCE: Duration = Duration::from_secs(10);
/// The fixed address that the drive gets.
const ADDRESS: u16 = 1;
/// Watchdog time of process data, in ticks of 100 µs unless somebody has changed the divider.
const WATCHDOG: (Place<u16>, u16) = (Place::simple(0x0420), 10_000);

#[tokio::main]
async fn main() -> process::ExitCode {
    // A panic in one of etherage's own tasks would leave the others waiting.
    let usual = panic::take_hook();
    panic::set_hook(Box::new(move |info| {
        usual(info);
        println!("FAILED, the check after those above: panicked");
        process::exit(COULD_NOT_SAY.into());
    }));
    let arguments: Vec<String> = env::args().skip(1).collect();
    let [interface, table, name] = arguments.as_slice() else {
        eprintln!("usage: servocrab-interop-etherage INTERFACE TABLE DRIVE");
        return process::ExitCode::FAILURE;
    };
    let table = fs::read_to_string(table).expect("the table");
    match run(interface, &Drive::named(&table, name)).await {
        Ok(()) => process::ExitCode::SUCCESS,
        Err(error) => {
            println!("FAILED, the check after those above: {error}");
            if error.is::<Judgement>() {
                process::ExitCode::FAILURE
            } else {
                process::ExitCode::from(COULD_NOT_SAY)
            }
        }
    }
}

async fn run(interface: &str, drive: &Drive) -> Outcome {
    let master = Master::new(EthernetSocket::new(interface)?);
    let mut slave = in_time("scan", acyclic::scan(&master)).await?;
    let memory = in_time("SII", acyclic::sii(&mut slave, drive)).await?;

    in_time("INIT", slave.switch(CommunicationState::Init)).await?;
    in_time("address", slave.set_address(ADDRESS)).await?;
    in_time("mailbox", slave.init_coe()).await?;
    in_time("PREOP", slave.switch(CommunicationState::PreOperational)).await?;
    in_time("SDO", acyclic::expedited(&slave)).await?;
    in_time("SDO", acyclic::normal(&slave, drive, memory.mailbox)).await?;
    in_time("SDO", acyclic::complete_access(&slave, drive)).await?;
    in_time("SDO", acyclic::aborts(&slave)).await?;

    let config = Config::default();
    let mapping = Mapping::new(&config);
    let places = cyclic::place(&mapping, drive, &memory);
    let group = master.group(&mapping).await;
    in_time("mapping", acyclic::mapping(&slave, &group, drive)).await?;
    in_time("clock", clock(&mut slave)).await?;
    raw(&slave)
        .fpwr(ADDRESS, WATCHDOG.0, WATCHDOG.1)
        .await
        .one()?;
    in_time("SAFEOP", slave.switch(CommunicationState::SafeOperational)).await?;
    ok("safe_op", "SAFEOP");

    let bench = Bench::new(&group, drive, places);
    tokio::select! {
        done = bench.checks(&mut slave) => done?,
        () = bench.exchange() => {}
    }
    in_time("INIT", slave.switch(CommunicationState::Init)).await?;
    ok("back_to_init", "INIT");
    Ok(())
}

/// Access to registers past what etherage guards; here no two write the same one.
fn raw<'a>(slave: &'a Slave<'_>) -> &'a Arc<RawMaster> {
    unsafe { slave.raw_master() }
}

/// Offsets and delays as etherage measures them, then SYNC0.
async fn clock(slave: &mut Slave<'_>) -> Outcome {
    let clock = DistributedClock::new(raw(slave).clone(), None, Some(CLOCK_SAMPLES)).await?;
    slave.init_sync(SYNC0, SYNC0_AHEAD).await?;
    let active: [u8; 2] = slave.physical_read(Place::simple(0x0980)).await?;
    expect(
        "the SYNC unit is on, with SYNC0 (0981h)",
        active[1] & 0x03,
        0x03,
    )?;
    let cycle: u32 = slave.physical_read(Place::simple(0x09A0)).await?;
    expect("SYNC0's cycle (09A0h)", u128::from(cycle), SYNC0.as_nanos())?;
    drop(clock);
    ok("clock", format_args!("SYNC0 each {cycle} ns"));
    Ok(())
}

/// Reports a check that was passed.
fn ok(check: &str, seen: impl std::fmt::Display) {
    println!("ok {check}: {seen}");
}

/// The drive answered, and not as it should.
#[derive(Debug)]
struct Judgement(String);

impl fmt::Display for Judgement {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl Error for Judgement {}

fn expect<T: PartialEq + Debug>(what: &str, seen: T, wanted: T) -> Outcome {
    if seen == wanted {
        return Ok(());
    }
    let text = format!("{what}: expected {wanted:?}, got {seen:?}");
    Err(Judgement(text).into())
}

/// Ends what would wait for ever.
async fn in_time<T, E: Into<Box<dyn Error>>>(
    what: &str,
    work: impl Future<Output = Result<T, E>>,
) -> Outcome<T> {
    let Ok(done) = time::timeout(PATIENCE, work).await else {
        return Err(format!("{what}: not in {PATIENCE:?}").into());
    };
    done.map_err(|error| {
        let error = error.into();
        let text = format!("{what}: {error}");
        if error.is::<Judgement>() {
            Judgement(text).into()
        } else {
            text.into()
        }
    })
}
