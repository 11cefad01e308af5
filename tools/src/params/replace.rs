//! A drive that was put in place of another one: what differs is shown, and then it gets the alias and the parameters of the other one.

use std::path::PathBuf;

use clap::Args;
use serde_json::json;
use servocrab::{
    bus::{EepromContent, ImageKind},
    parameters::{self, ParameterSet, Progress},
    sii::{Identity, SiiImage},
};

use super::{Consent, compared, loaded, of_differences};
use crate::{
    eeprom,
    line::{Found, LineArguments, found},
    machine::Machine,
    output::{Done, Failure, Tool, bar, table, told},
};

/// The line is reset, and its drives are in PREOP: nothing moves. Refused where a program has the interface: that replaces its drive
/// itself, by `Network::replace`.
#[derive(Args)]
pub(crate) struct Arguments {
    #[command(flatten)]
    line: LineArguments,
    /// An axis of the drive, as the machine's file names it; without a file its position, or 0-2 for the second one of the drive at 0
    #[arg(long, value_name = "NAME")]
    axis: String,
    /// The backup of the old drive, as `params backup` writes it
    #[arg(long, value_name = "FILE")]
    from: PathBuf,
    /// The line's description, as `servocrab init` has written it with the old drive: the names of the axes, and its station alias
    #[arg(long, value_name = "FILE")]
    machine: Option<PathBuf>,
    /// Where what is in the EEPROM is kept before an alias is written [default: eeprom-POSITION.old]
    #[arg(long, value_name = "FILE")]
    keep: Option<PathBuf>,
    #[command(flatten)]
    consent: Consent,
}

/// What stands there, and what it is to get.
struct Plan {
    position: u16,
    old: Identity,
    new: Identity,
    /// The alias that it has, and the one that it is to have.
    alias: (u16, Option<u16>),
}

/// Does it.
pub(crate) async fn run(tool: &Tool, arguments: &Arguments) -> Done {
    // What cannot be used takes no line.
    let set = loaded(&arguments.from)?;
    let machine = arguments
        .machine
        .as_deref()
        .map(Machine::load)
        .transpose()?;
    let (position, alias) = place(arguments, machine.as_ref())?;
    if arguments.line.program()?.is_some() {
        return Err(
            "a running program has the line: end it first, or have it replace its drive".into(),
        );
    }
    let line = arguments.line.scan(tool).await?;
    let devices = found(&line);
    let device = devices.iter().find(|device| device.id.position == position);
    let device = device.ok_or_else(|| format!("there is nothing at position {position}"))?;
    let sdo = device.objects()?;
    let plan = plan(*device, &set, alias)?;
    let differences = tool.unless_interrupted(compared(sdo, &set)).await?;
    let shown = format!("{}{differences}", plan.shown());
    let json = json!({
        "position": position,
        "old": plan.old,
        "new": plan.new,
        "alias": plan.alias.1,
        "would_write": of_differences(&differences),
    });
    if arguments.consent.dry_run {
        tool.say(&json, format_args!("{shown}nothing is written\n"))?;
        return Ok(true);
    }
    if !tool.json {
        tool.note(format_args!("what differs:\n{shown}"));
    }
    let question = format!(
        "Take {} with serial number {:08X}h for the drive of axis {}, and write {} of {} parameters to it?",
        sdo.drive(),
        plan.new.serial,
        arguments.axis,
        differences.0.len(),
        set.parameters.len()
    );
    tool.agreed_or_shown(arguments.consent.yes, &question)
        .await?;
    let work = async {
        let bar = bar("restoring");
        let restored = set.restore(sdo, Progress::of(&mut told(&bar))).await;
        bar.finish_and_clear();
        let written = restored?.written.len();
        if parameters::store_support(sdo)
            .await?
            .is_some_and(|support| support.by_itself)
        {
            return Ok(written);
        }
        parameters::store(sdo).await?;
        Ok(written)
    };
    let written = tool.unless_interrupted(work).await?;
    let mut text = format!("{written} parameters written, all stored in the drive's memory\n");
    let mut in_force = true;
    if let Some(alias) = plan.writes_alias() {
        let before = line.read_eeprom(position).await?;
        let image = before.image()?.with_alias(alias);
        let keep = arguments.keep.clone();
        let keep = keep.unwrap_or_else(|| format!("eeprom-{position}.old").into());
        drop(devices);
        in_force = write_alias(tool, line, &before, &image, &keep).await?;
        text += &match in_force {
            true => format!("alias {alias} written, and in force\n"),
            false => format!(
                "alias {alias} written: switch the drive off and on, so that it is in force\n"
            ),
        };
    } else {
        drop(devices);
        line.close().await;
    }
    if plan.old.serial != plan.new.serial {
        text += "home its axes, and change the serial number where the program or machine.toml names it\n";
    }
    let json = json!({
        "written": written,
        "stored": true,
        "alias": plan.writes_alias(),
        "in_force": in_force,
    });
    tool.say(&json, text)?;
    Ok(true)
}

/// The position of the axis' drive, and the alias that it had, where the file says that.
fn place(arguments: &Arguments, machine: Option<&Machine>) -> Result<(u16, Option<u16>), Failure> {
    let name = &arguments.axis;
    let Some(machine) = machine else {
        let position = name.split('-').next().unwrap_or(name);
        let named = || format!("axis {name} has no position in its name: say --machine FILE");
        return Ok((position.parse().map_err(|_| named())?, None));
    };
    let mut devices = (0..).zip(&machine.devices);
    let is_of = |device: &crate::machine::Device| device.axes.iter().any(|axis| axis.name == *name);
    let of_axis = devices.find(|(_, device)| is_of(device));
    let (position, device) =
        of_axis.ok_or_else(|| format!("the machine's file names no axis {name}"))?;
    Ok((position, (device.alias != 0).then_some(device.alias)))
}

fn plan(device: Found<'_>, set: &ParameterSet, alias: Option<u16>) -> Result<Plan, Failure> {
    let old = set.identity.ok_or(
        "the backup does not say of which drive it is: write the parameters with `params restore`",
    )?;
    let new = device.id.identity;
    if (old.vendor, old.product) != (new.vendor, new.product) {
        return Err(format!(
            "the backup is of another kind of drive: expected {old}, and {} is {new}",
            device.id
        )
        .into());
    }
    if new.revision < old.revision {
        let (expected, got) = (old.revision, new.revision);
        return Err(format!(
            "{} has the revision {got:08X}h, and a drive of the revision {expected:08X}h is replaced by one of the same or a higher \
             revision alone",
            device.id
        )
        .into());
    }
    Ok(Plan {
        position: device.id.position,
        old,
        new,
        alias: (device.device.map_or(0, |device| device.alias), alias),
    })
}

impl Plan {
    fn writes_alias(&self) -> Option<u16> {
        let (has, wanted) = self.alias;
        wanted.filter(|wanted| *wanted != has)
    }

    fn shown(&self) -> String {
        let (old, new) = (self.old, self.new);
        let row = |what: &str, old: u32, new: u32| {
            [what.into(), format!("{old:08X}h"), format!("{new:08X}h")]
        };
        let mut rows = vec![
            [
                "position".into(),
                self.position.to_string(),
                self.position.to_string(),
            ],
            row("vendor", old.vendor, new.vendor),
            row("product", old.product, new.product),
            row("revision", old.revision, new.revision),
            row("serial", old.serial, new.serial),
        ];
        if let (has, Some(wanted)) = self.alias {
            rows.push(["alias".into(), wanted.to_string(), has.to_string()]);
        }
        table(["", "old", "new"], &rows)
    }
}

/// Whether the alias is in force. It ends the line.
async fn write_alias(
    tool: &Tool,
    line: servocrab::bus::Line,
    before: &EepromContent,
    image: &SiiImage,
    keep: &std::path::Path,
) -> Result<bool, Failure> {
    eeprom::kept(tool, before, keep)?;
    tool.note("writing the alias: leave the device switched on");
    // Ctrl-C comes too late from here on: a part of an image is none.
    let written = line.write_eeprom(before, image, ImageKind::Same).await;
    let written = written.map_err(|error| {
        format!(
            "{error}. What was there is in {keep}: `servocrab eeprom --drive {} write {keep}`",
            before.position(),
            keep = keep.display()
        )
    })?;
    Ok(written.alias == image.alias())
}
