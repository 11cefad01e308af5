//! What is on the line becomes `machine.toml`, and with `--rust` a `line.rs`.

use std::{
    fmt::Write as _,
    io::{self, Write as _},
    path::{Path, PathBuf},
    process::{Command, Stdio},
};

use clap::Args;
use serde_json::json;
use servocrab::{
    DriveConfig,
    bus::{Line, LineDevice},
    coe::{ObjectAddress, SdoHandle, obj},
    drives,
    esi::Esi,
    parameters::NewFile,
    sii::{Pdo, Sii},
};

use super::{Address, Axis, Device, Direction, Kind, Machine, Point, rust};
use crate::{
    axes::axis_name,
    line::LineArguments,
    output::{Done, Failure, Tool},
    report::clock_of,
    scan::count_axes,
};

/// The line is reset; nothing is configured.
#[derive(Args)]
pub(crate) struct Arguments {
    #[command(flatten)]
    line: LineArguments,
    /// The file to write
    #[arg(default_value = "machine.toml")]
    file: PathBuf,
    /// Write the line as Rust too, for a program to include
    #[arg(long, value_name = "FILE", num_args = 0..=1, require_equals = true, default_missing_value = "line.rs")]
    rust: Option<PathBuf>,
    /// A maker's ESI file: the drives that are in it are described by it
    #[arg(long, value_name = "FILE")]
    esi: Vec<PathBuf>,
    /// Synchronise the drives that have a distributed clock by SYNC0
    #[arg(long)]
    clocks: bool,
    /// Replace files that are there without a question
    #[arg(long)]
    yes: bool,
}

pub(crate) async fn run(tool: &Tool, arguments: &Arguments) -> Done {
    let files = [Some(&arguments.file), arguments.rust.as_ref()];
    for file in files.into_iter().flatten().filter(|file| file.exists()) {
        tool.agreed(
            arguments.yes,
            &format!("{} is there already. Replace it?", file.display()),
        )
        .await?;
    }
    let mut files = Vec::new();
    for file in &arguments.esi {
        let esi = Esi::load(file)?;
        esi.warnings.iter().for_each(|warning| tool.note(warning));
        files.push((beside(file, &arguments.file)?, esi));
    }
    let line = arguments.line.scan(tool).await?;
    let found = tool
        .unless_interrupted(machine(&line, &files, arguments.clocks))
        .await;
    line.close().await;
    let machine = found?;
    NewFile::write(&arguments.file, toml(&machine).as_bytes())?;
    let mut written = vec![arguments.file.display().to_string()];
    if let Some(file) = &arguments.rust {
        NewFile::write(file, formatted(rust::source(&machine)).as_bytes())?;
        written.push(file.display().to_string());
    }
    let count = |is: fn(Kind) -> bool| {
        machine
            .devices
            .iter()
            .filter(|device| is(device.kind))
            .count()
    };
    let text = format!(
        "{} device(s), of them {} drive(s) with {} axes and {} with inputs or outputs: {}\n",
        machine.devices.len(),
        count(Kind::is_drive),
        machine
            .devices
            .iter()
            .map(|device| device.axes.len())
            .sum::<usize>(),
        count(|kind| kind == Kind::Io),
        written.join(", "),
    );
    tool.say(
        &json!({"devices": machine.devices.len(), "written": written}),
        text,
    )?;
    Ok(true)
}

/// The file as the machine's file names it: by its way from there, where it is in the same directory or below.
fn beside(file: &Path, machine: &Path) -> io::Result<PathBuf> {
    let (file, machine) = (std::path::absolute(file)?, std::path::absolute(machine)?);
    let below = machine
        .parent()
        .and_then(|directory| file.strip_prefix(directory).ok());
    Ok(below.map_or_else(|| file.clone(), Path::to_path_buf))
}

/// As rustfmt has it; without rustfmt as it is.
fn formatted(source: String) -> String {
    let run = || {
        let mut child = Command::new("rustfmt")
            .args(["--edition", "2024", "--emit", "stdout"])
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .ok()?;
        // Dropped, so that it sees the end. It writes nothing before.
        child.stdin.take()?.write_all(source.as_bytes()).ok()?;
        let output = child.wait_with_output().ok()?;
        let formatted = String::from_utf8(output.stdout).ok()?;
        (output.status.success() && !formatted.is_empty()).then_some(formatted)
    };
    run().unwrap_or(source)
}

async fn machine(line: &Line, files: &[(PathBuf, Esi)], clocks: bool) -> Result<Machine, Failure> {
    let mut devices = Vec::new();
    for device in line.devices() {
        if let Some(problem) = &device.problem {
            return Err(problem.to_string().into());
        }
        devices.push(found(device, files, clocks).await?);
    }
    Ok(Machine {
        cycle_us: super::a_millisecond(),
        devices,
        directory: PathBuf::new(),
    })
}

async fn found(
    device: &LineDevice,
    files: &[(PathBuf, Esi)],
    clocks: bool,
) -> Result<Device, Failure> {
    let identity = device.id.identity;
    let mut found = Device {
        name: device.id.name.clone(),
        kind: Kind::Other,
        vendor: identity.vendor,
        product: identity.product,
        revision: identity.revision,
        serial: identity.serial,
        alias: device.alias,
        clock_bits: device.clock_bits,
        assign_activate: None,
        esi: None,
        alarms: None,
        absent: Vec::new(),
        axes: Vec::new(),
        points: Vec::new(),
    };
    let axes = match &device.sdo {
        Some(sdo) => count_axes(sdo).await?,
        None => 0,
    };
    match &device.sdo {
        Some(sdo) if axes > 0 => {
            let position = device.id.position;
            found.axes = (1..=axes)
                .map(|axis| Axis::named(axis_name(position, axis)))
                .collect();
            let mut described = None;
            for (file, esi) in files
                .iter()
                .filter(|(_, esi)| esi.vendor == identity.vendor)
            {
                match esi.device(identity.product, identity.revision) {
                    Ok(drive) => described = described.or(Some((file, drive))),
                    Err(error) if error.skipped.is_some() => return Err(error.into()),
                    Err(_) => {}
                }
            }
            match (described, Kind::of(&identity)) {
                (Some((file, drive)), _) => {
                    // What cannot be used, or executed, is said here.
                    DriveConfig::from_esi(drive)?;
                    found.kind = Kind::Esi;
                    found.esi = Some(file.clone());
                }
                (None, Some(kind)) => found.kind = kind,
                (None, None) => {
                    found.kind = Kind::Generic;
                    found.absent = absent(sdo).await.into_iter().map(Address).collect();
                }
            }
            if clocks {
                found.assign_activate = clock_of(device, None);
            }
        }
        _ => {
            found.points = device.sii.as_ref().map(points_of).unwrap_or_default();
            if !found.points.is_empty() {
                found.kind = Kind::Io;
            }
        }
    }
    Ok(found)
}

/// The objects of a plain drive's default mapping that this one does not have.
pub(crate) async fn absent(sdo: &SdoHandle) -> Vec<ObjectAddress> {
    let generic = drives::generic();
    let mapped = generic
        .axes
        .iter()
        .flat_map(|axis| axis.outputs.iter().chain(&axis.inputs));
    let mut absent = Vec::new();
    for object in mapped {
        let needed = [obj::CONTROLWORD.address(), obj::STATUSWORD.address()];
        if !needed.contains(&object.address())
            && sdo.read_bytes(object.index, object.subindex).await.is_err()
        {
            absent.push(object.address());
        }
    }
    absent
}

/// What a device that is no drive exchanges by default: its outputs, then its inputs.
pub(crate) fn points_of(sii: &Sii) -> Vec<Point> {
    let outputs = sii
        .rx_pdos
        .iter()
        .flat_map(|pdo| points(sii, pdo, Direction::Output));
    let inputs = sii
        .tx_pdos
        .iter()
        .flat_map(|pdo| points(sii, pdo, Direction::Input));
    outputs.chain(inputs).collect()
}

/// The entries of a PDO that is exchanged by default.
fn points(sii: &Sii, pdo: &Pdo, direction: Direction) -> Vec<Point> {
    let string = |number: u8| {
        let place = usize::from(number).checked_sub(1);
        place
            .and_then(|place| sii.strings.get(place))
            .map_or("", String::as_str)
    };
    if pdo.sync_manager.is_none() {
        return Vec::new();
    }
    let entries = pdo.entries.iter();
    let points = entries.map(|entry| {
        let names = [string(pdo.name), string(entry.name)];
        let names: Vec<_> = names.into_iter().filter(|name| !name.is_empty()).collect();
        Point {
            direction,
            name: names.join("."),
            object: Address(ObjectAddress::new(entry.index, entry.subindex)),
            bits: entry.bits,
        }
    });
    points.collect()
}

/// The file.
pub(super) fn toml(machine: &Machine) -> String {
    let quoted = |text: &str| toml::Value::String(text.into()).to_string();
    let mut text = format!(
        "# An EtherCAT line, as `servocrab init` found it: `servocrab sim` simulates it, `servocrab check` compares a line with it.\n\
         cycle_us = {}\n",
        machine.cycle_us
    );
    for (position, device) in machine.devices.iter().enumerate() {
        let _ = write!(
            text,
            "\n# Position {position}\n[[device]]\nname = {}\nkind = \"{}\"\nvendor = 0x{:08X}\nproduct = 0x{:08X}\n\
             revision = 0x{:08X}\nserial = 0x{:08X}\n",
            quoted(&device.name),
            device.kind.name(),
            device.vendor,
            device.product,
            device.revision,
            device.serial,
        );
        if device.alias != 0 {
            let _ = writeln!(text, "alias = {}", device.alias);
        }
        if let Some(bits) = device.clock_bits {
            let _ = writeln!(text, "clock_bits = {bits}");
        }
        if let Some(word) = device.assign_activate {
            let _ = writeln!(text, "assign_activate = 0x{word:04X}");
        }
        if let Some(file) = &device.esi {
            let _ = writeln!(text, "esi = {}", quoted(&file.to_string_lossy()));
        }
        if !device.absent.is_empty() {
            let all: Vec<_> = device
                .absent
                .iter()
                .map(|object| format!("\"{}\"", object.0))
                .collect();
            let _ = writeln!(text, "absent = [{}]", all.join(", "));
        }
        if !device.axes.is_empty() {
            let all: Vec<_> = device.axes.iter().map(|axis| quoted(&axis.name)).collect();
            let _ = writeln!(text, "axes = [{}]", all.join(", "));
        }
        for point in &device.points {
            let direction = match point.direction {
                Direction::Input => "input",
                Direction::Output => "output",
            };
            let _ = write!(
                text,
                "[[device.point]]\ndirection = \"{direction}\"\nname = {}\nobject = \"{}\"\nbits = {}\n",
                quoted(&point.name),
                point.object.0,
                point.bits,
            );
        }
    }
    text
}
