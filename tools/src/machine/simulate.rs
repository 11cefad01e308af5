//! The line of a `machine.toml`, simulated on a network interface.

use std::{
    io,
    path::PathBuf,
    time::{Duration, Instant},
};

use clap::Args;
use serde_json::json;
use servocrab_sim::{
    Blueprint, ClockMode, ClockWidth, Description, Device as Simulated, Direction as Way,
    EsiChoice, EsiDrive, Identity, PdoDescription, PdoEntryDescription, Segment,
    SyncManagerDescription, SyncManagerUse,
    link::{FRAME_CAPACITY, RawSocket},
    personality::Servo,
};

use super::{Device, Direction, Kind, Machine};
use crate::output::{Done, Failure, Tool};

#[derive(Args)]
pub(crate) struct Arguments {
    /// The line's description, as `init` writes it
    #[arg(default_value = "machine.toml")]
    file: PathBuf,
    /// Network interface to answer on, for example one end of a veth pair
    #[arg(long, value_name = "NAME")]
    interface: String,
    /// Seconds to run; without it, until Ctrl-C
    #[arg(long = "for", value_name = "SECONDS")]
    seconds: Option<u32>,
}

/// How long is waited for a frame before Ctrl-C is looked for again.
const WAIT: Duration = Duration::from_millis(1);

pub(crate) fn run(tool: &Tool, arguments: &Arguments) -> Done {
    let machine = Machine::load(&arguments.file)?;
    let mut segment = devices(&machine)?
        .into_iter()
        .fold(Segment::new(), Segment::with);
    let socket = RawSocket::open(&arguments.interface)?;
    let devices = segment.len();
    let text = format!(
        "listening on {}: {devices} SubDevice(s)\n",
        arguments.interface
    );
    tool.say(
        &json!({"listening": arguments.interface, "devices": devices}),
        text,
    )?;
    let start = Instant::now();
    let end = arguments
        .seconds
        .map(|seconds| Duration::from_secs(seconds.into()));
    let mut buffer = [0; FRAME_CAPACITY];
    while !tool.is_interrupted() && end.is_none_or(|end| start.elapsed() < end) {
        socket.wait(WAIT)?;
        while let Some(length) = socket.receive(&mut buffer)? {
            let frame = buffer.get_mut(..length).unwrap_or(&mut []);
            if segment.process(frame, start.elapsed()) {
                answer(&socket, frame)?;
            }
        }
        segment.advance(start.elapsed());
    }
    Ok(true)
}

/// A frame that the interface does not take is lost, as on a cable.
fn answer(socket: &RawSocket, frame: &[u8]) -> io::Result<()> {
    match socket.send(frame) {
        Err(error)
            if matches!(
                error.kind(),
                io::ErrorKind::WouldBlock | io::ErrorKind::NetworkDown
            ) =>
        {
            Ok(())
        }
        done => done,
    }
}

/// The devices, just switched on.
pub(crate) fn devices(machine: &Machine) -> Result<Vec<Simulated>, Failure> {
    let devices = machine.devices.iter().enumerate();
    let devices = devices.map(|(position, device)| {
        simulated(machine, device)
            .map_err(|error| format!("device {position} \"{}\": {error}", device.name).into())
    });
    devices.collect()
}

fn simulated(machine: &Machine, device: &Device) -> Result<Simulated, Failure> {
    let identity = Identity {
        vendor: device.vendor,
        product: device.product,
        revision: device.revision,
        serial: device.serial,
    };
    let clock = device.clock_bits.map(|bits| match bits {
        32 => ClockWidth::Bits32,
        _ => ClockWidth::Bits64,
    });
    let servo = match device.kind {
        Kind::Akd2g => Servo::akd2g(),
        Kind::Ax2000 => Servo::ax2000(),
        Kind::Pp2010 => Servo::pp2010(),
        Kind::Sigma7 => Servo::sigma7(),
        Kind::Generic if device.axes.len() > 1 => {
            return Err("a plain drive of several axes is simulated by its ESI file alone (`servocrab init --esi`)".into());
        }
        Kind::Generic => Servo::generic(),
        Kind::Esi => {
            let file = machine
                .esi_of(device)
                .ok_or("kind = \"esi\" without a file")?;
            let of = |revision| {
                EsiDrive::choose(&EsiChoice {
                    file: file.clone(),
                    product: Some(device.product),
                    revision,
                })
            };
            let drive = of(Some(device.revision)).or_else(|_| of(None))?.build();
            let got = drive.description().identity;
            if got.vendor != device.vendor {
                return Err(format!(
                    "{} is of vendor {:08X}h, and expected is {:08X}h",
                    file.display(),
                    got.vendor,
                    device.vendor
                )
                .into());
            }
            return Ok(drive);
        }
        Kind::Io | Kind::Other => {
            let mut description = Description::new(&device.name, identity);
            description.alias = device.alias;
            description.clock = clock;
            description.clock_modes = Vec::<ClockMode>::new();
            exchange(&mut description, device)?;
            return Ok(Simulated::new(Blueprint {
                description,
                drive: None,
                cycle: Duration::from_millis(1),
            }));
        }
    };
    Ok(servo
        .identity(identity)
        .alias(device.alias)
        .clock(clock)
        .build())
}

/// Where process data lies: outputs, inputs, and how many bytes of each.
const AREAS: [(Direction, Way, u16, u16); 2] = [
    (Direction::Output, Way::Outputs, 0x1000, 0x1600),
    (Direction::Input, Way::Inputs, 0x1800, 0x1A00),
];
const AREA: usize = 0x0400;

/// The points as PDOs, one each, so that each has the name that it has in the file.
fn exchange(description: &mut Description, device: &Device) -> Result<(), Failure> {
    for (direction, way, start, first) in AREAS {
        let points: Vec<_> = device
            .points
            .iter()
            .filter(|point| point.direction == direction)
            .collect();
        let bits: usize = points.iter().map(|point| usize::from(point.bits)).sum();
        let bytes = bits.div_ceil(8);
        if bytes > AREA || points.len() > 0x100 {
            return Err(format!(
                "{bytes} bytes of {} points are more than can be simulated",
                points.len()
            )
            .into());
        }
        if points.is_empty() {
            continue;
        }
        let sync_manager = description.sync_managers.len() as u8;
        let (purpose, control, usage) = match way {
            Way::Outputs => (SyncManagerUse::Outputs, 0x44, 1),
            Way::Inputs => (SyncManagerUse::Inputs, 0x20, 2),
        };
        description.sync_managers.push(SyncManagerDescription {
            start,
            length: bytes as u16,
            control,
            purpose,
        });
        description.fmmu_usage.push(usage);
        for (number, point) in (0..).zip(points) {
            let (pdo, entry) = point.name.split_once('.').unwrap_or(("", &point.name));
            // The program simulates one line, and ends: the names are its own until then.
            let named = |name: &str| -> &'static str { name.to_owned().leak() };
            description.pdos.push(PdoDescription {
                index: first + number,
                name: named(pdo),
                direction: way,
                sync_manager: Some(sync_manager),
                fixed: true,
                mandatory: false,
                excludes: Vec::new(),
                entries: vec![PdoEntryDescription {
                    index: point.object.0.index,
                    subindex: point.object.0.subindex,
                    name: named(entry),
                    data_type: match point.bits {
                        1 => 1,
                        2..=8 => 5,
                        9..=16 => 6,
                        _ => 7,
                    },
                    bits: point.bits,
                }],
            });
        }
    }
    Ok(())
}
