//! How steady the cycles of a line are on this machine: a table, JSON and a picture. The drives are brought into OP, and the cycles
//! run with all axes disabled. Nothing moves.

mod measure;
mod picture;
mod table;

use std::{path::PathBuf, time::Duration};

use clap::Args;
use servocrab::{
    bus::{DistributedClock, LineDevice, NetworkBuilder, RealTime, Scheduling},
    coe::obj,
    drives::{self, DriveDescription},
};

use picture::Picture;

use crate::{
    axes::{DescribedBy, axis_name},
    line::LineArguments,
    machine::{init::absent, without},
    output::{Done, Failure, Tool},
};

/// SYNC0 alone, what most drives take.
const SYNC0: u16 = 0x0300;

/// Ctrl-C ends the measurement early, with the report of what was measured until then.
#[derive(Args)]
pub(crate) struct Arguments {
    #[command(flatten)]
    line: LineArguments,
    #[command(flatten)]
    described: DescribedBy,
    /// Time from one cycle to the next, in microseconds.
    #[arg(long, default_value_t = 1000, value_parser = clap::value_parser!(u32).range(100..=20_000))]
    cycle_us: u32,
    /// How long to measure.
    #[arg(long, default_value_t = 10, value_parser = clap::value_parser!(u32).range(1..=86_400))]
    seconds: u32,
    /// Synchronise the drives that have a distributed clock by SYNC0. WORD is their assign-activate (registers 0980h and 0981h) in
    /// hexadecimal; without it, what the EEPROM of each names first, or 0300. With --machine the file says which.
    #[arg(long, value_name = "WORD", num_args = 0..=1, require_equals = true, value_parser = word, conflicts_with = "machine")]
    clocks: Option<Option<u16>>,
    /// Run the bus thread as SCHED_FIFO with this priority, and lock the memory.
    #[arg(long, value_parser = clap::value_parser!(u8).range(1..=99))]
    priority: Option<u8>,
    /// Run the bus thread on this processor alone.
    #[arg(long)]
    processor: Option<usize>,
    /// Draw a picture into this file; a file that is there is replaced.
    #[arg(long)]
    svg: Option<PathBuf>,
}

pub(crate) async fn run(tool: &Tool, arguments: &Arguments) -> Done {
    let builder = builder(tool, arguments).await?;
    // Before the measurement, and not behind it: its time would be lost where nothing can be written.
    let picture = arguments.svg.as_deref().map(Picture::create).transpose()?;
    let start = arguments.described.start(builder);
    let net = tool.unless_interrupted(start).await?;
    let time = Duration::from_secs(arguments.seconds.into());
    let report = measure::measure(tool, &net, time, cycle(arguments)).await;
    net.shutdown().await?;
    let report = report?;
    tool.say(&report.json(), report.text())?;
    // Last: a picture that cannot be written costs no report.
    if let Some(picture) = picture {
        picture.complete(&report)?;
    }
    Ok(true)
}

fn word(text: &str) -> Result<u16, std::num::ParseIntError> {
    u16::from_str_radix(text.trim_end_matches('h').trim_start_matches("0x"), 16)
}

fn cycle(arguments: &Arguments) -> Duration {
    Duration::from_micros(arguments.cycle_us.into())
}

/// The network of all drives of the line, each by its own description.
async fn builder(tool: &Tool, arguments: &Arguments) -> Result<NetworkBuilder, Failure> {
    let mut real_time = RealTime::new();
    if let Some(priority) = arguments.priority {
        real_time = real_time
            .scheduling(Scheduling::Fifo(priority))
            .lock_memory();
    }
    if let Some(processor) = arguments.processor {
        real_time = real_time.processors([processor]);
    }
    let mut builder = arguments
        .line
        .network()?
        .cycle(cycle(arguments))
        .real_time(real_time);
    if let Some(machine) = arguments.described.machine()? {
        return Ok(machine.on(builder)?.cycle(cycle(arguments)));
    }
    let file = arguments.described.file(tool)?;
    let line = arguments.line.scan(tool).await?;
    let (mut found, mut clocks) = (0, 0);
    for device in line.devices() {
        if let Some((mut drive, axes)) = file.drive(device).await? {
            let position = device.id.position;
            for axis in 1..=axes {
                drive = drive.axis(axis_name(position, axis));
            }
            if let Some(word) = arguments.clocks
                && let Some(clock) = clock_of(device, word)
            {
                drive = drive.dc(DistributedClock::new(clock));
                clocks += 1;
            }
            builder = builder.drive(position, drive);
            found += 1;
        }
    }
    line.close().await;
    file.is_used()?;
    if found == 0 {
        return Err("no drive was found on the line".into());
    }
    if arguments.clocks.is_some() && clocks == 0 {
        return Err(
            "no drive on the line has a distributed clock: measure without --clocks".into(),
        );
    }
    Ok(builder)
}

/// The assign-activate by which a drive follows its distributed clock; `None` if it has none. By this word, or by the first of its EEPROM's modes that
/// has SYNC0.
pub(crate) fn clock_of(device: &LineDevice, word: Option<u16>) -> Option<u16> {
    device.clock_bits?;
    let modes = device.sii.iter().flat_map(|sii| &sii.clock_modes);
    Some(word.unwrap_or_else(|| with_sync0(modes.map(|mode| mode.assign_activate))))
}

fn with_sync0(mut words: impl Iterator<Item = u16>) -> u16 {
    words.find(|word| word & SYNC0 == SYNC0).unwrap_or(SYNC0)
}

/// How a device is driven: by its maker's description, or by the profile's objects; `None` if it is no drive.
pub(crate) async fn description_of(device: &LineDevice) -> Option<DriveDescription> {
    // A drive answers for its statusword, whoever made it; couplers and terminals of the same maker do not.
    let sdo = device.sdo.as_ref()?;
    sdo.read(obj::STATUSWORD).await.ok()?;
    let made = drives::for_identity(&device.id.identity);
    if made.is_some() {
        return made;
    }
    // Of the profile's objects a drive need not have all.
    Some(without(drives::generic(), &absent(sdo).await))
}

#[cfg(test)]
mod tests {
    use servocrab::{Network, link::Wire};
    use servocrab_sim::{
        Segment,
        personality::{self, Servo},
    };

    use super::{DriveDescription, clock_of, description_of, drives, obj, with_sync0, word};

    #[test]
    fn a_clock_is_used_where_there_is_one_by_the_first_mode_that_has_sync0() {
        let mut segment = Segment::new()
            .with(personality::akd2g())
            .with(Servo::generic().clock(None).build());
        let link = Wire::new(move |frame: &mut [u8], now| segment.process(frame, now));
        smol::block_on(async {
            let line = Network::builder().link(link).scan().await.unwrap();
            let clocks =
                |word| [0, 1].map(|position: usize| clock_of(&line.devices()[position], word));
            assert_eq!(clocks(None), [Some(0x0300), None]);
            assert_eq!(clocks(Some(0x0700)), [Some(0x0700), None]);
            line.close().await;
        });
        assert_eq!(with_sync0([0x0000, 0x0100, 0x0730].into_iter()), 0x0730);
        assert_eq!(with_sync0([0x0000].into_iter()), 0x0300);
        assert_eq!(["0x0700", "0730h"].map(word), [Ok(0x0700), Ok(0x0730)]);
        assert!(word("SYNC0").is_err());
    }

    #[test]
    fn of_a_mixed_line_the_drives_are_measured_each_by_its_own_description() {
        let mut segment = Segment::new()
            .with(personality::coupler())
            .with(personality::pp2010())
            .with(personality::akd2g())
            .with(personality::io_terminal())
            .with(personality::ax2000())
            .with(personality::sigma7())
            .with(personality::generic());
        let link = Wire::new(move |frame: &mut [u8], now| segment.process(frame, now));
        let names = smol::block_on(async {
            let line = Network::builder().link(link).scan().await.unwrap();
            let mut names = Vec::new();
            for device in line.devices() {
                let description = description_of(device).await;
                names.push(description.map(|description| {
                    let objects = &description.axes[0].inputs;
                    (
                        description.name.to_string(),
                        objects.contains(&obj::VELOCITY_ACTUAL.into()),
                    )
                }));
            }
            line.close().await;
            names
        });
        let name = |description: DriveDescription| description.name.to_string();
        assert_eq!(
            names,
            [
                None,
                // It has no 606Ch.
                Some((name(drives::generic()), false)),
                Some((name(drives::akd2g()), true)),
                None,
                Some((name(drives::ax2000()), true)),
                Some((name(drives::sigma7()), true)),
                Some((name(drives::generic()), true)),
            ]
        );
    }
}
