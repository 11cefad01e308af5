//! A line compared with its `machine.toml`, and measured at standstill: one page, to be signed at acceptance. Nothing moves, and no
//! parameter of a drive is changed but what every bring-up sets.

use std::{path::PathBuf, time::Duration};

use clap::Args;
use serde_json::json;
use servocrab::{
    Network,
    bus::{Line, LineDevice, Statistics},
    coe::{AxisOffset, Number, Object, ObjectAddress, Readable, SdoHandle, Value, obj},
    ds402::{AbortConnection, QuickStopOption},
    esi::Esi,
};

use super::{Device, Machine};
use crate::{
    line::LineArguments,
    meaning,
    output::{Done, Failure, Tool, plain, table},
};

#[derive(Args)]
pub(crate) struct Arguments {
    #[command(flatten)]
    line: LineArguments,
    /// What is expected, as `init` writes it
    #[arg(default_value = "machine.toml")]
    file: PathBuf,
    /// How long to watch the axes at standstill
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..=3600))]
    seconds: u32,
}

/// What a row of the page says.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum CheckVerdict {
    Good,
    Wrong,
    /// To be looked at; it does not fail the check.
    Note,
}

impl CheckVerdict {
    const fn name(self) -> &'static str {
        match self {
            Self::Good => "good",
            Self::Wrong => "wrong",
            Self::Note => "note",
        }
    }
}

/// A row of the page.
struct Row {
    verdict: CheckVerdict,
    what: String,
    check: &'static str,
    found: String,
    /// What to do about it.
    change: Option<String>,
}

#[derive(Default)]
struct Page {
    rows: Vec<Row>,
}

impl Page {
    fn good(&mut self, what: &str, check: &'static str, found: impl Into<String>) {
        self.row(CheckVerdict::Good, what, check, found.into(), None);
    }

    fn wrong(
        &mut self,
        what: &str,
        check: &'static str,
        found: impl Into<String>,
        change: impl Into<String>,
    ) {
        self.row(
            CheckVerdict::Wrong,
            what,
            check,
            found.into(),
            Some(change.into()),
        );
    }

    fn note(
        &mut self,
        what: &str,
        check: &'static str,
        found: impl Into<String>,
        change: impl Into<String>,
    ) {
        self.row(
            CheckVerdict::Note,
            what,
            check,
            found.into(),
            Some(change.into()),
        );
    }

    fn row(
        &mut self,
        verdict: CheckVerdict,
        what: &str,
        check: &'static str,
        found: String,
        change: Option<String>,
    ) {
        self.rows.push(Row {
            verdict,
            what: what.to_owned(),
            check,
            found,
            change,
        });
    }

    fn passed(&self) -> bool {
        self.rows
            .iter()
            .all(|row| row.verdict != CheckVerdict::Wrong)
    }

    fn show(&self, tool: &Tool, arguments: &Arguments) -> Result<(), Failure> {
        let rows: Vec<_> = self
            .rows
            .iter()
            .map(|row| {
                json!({
                    "verdict": row.verdict.name(),
                    "what": row.what,
                    "check": row.check,
                    "found": row.found,
                    "change": row.change,
                })
            })
            .collect();
        let json = json!({"file": arguments.file, "passed": self.passed(), "checks": rows});
        let cells = |row: &Row| {
            [
                row.verdict.name().to_owned(),
                row.what.clone(),
                row.check.to_owned(),
                row.found.clone(),
            ]
        };
        let cells: Vec<_> = self.rows.iter().map(cells).collect();
        let mut text = format!(
            "Check of {} by servocrab {}\n\n",
            arguments.file.display(),
            env!("CARGO_PKG_VERSION")
        );
        text += &table(["", "device or axis", "check", "found"], &cells);
        for (verdict, heading) in [
            (CheckVerdict::Wrong, "To change"),
            (CheckVerdict::Note, "To look at"),
        ] {
            let rows = self.rows.iter().filter(|row| row.verdict == verdict);
            for (place, row) in rows.enumerate() {
                if place == 0 {
                    text += &format!("\n{heading}:\n");
                }
                let change = row.change.as_deref().unwrap_or("");
                text += &format!("- {}, {}: {change}\n", plain(&row.what), row.check);
            }
        }
        let wrong = self
            .rows
            .iter()
            .filter(|row| row.verdict == CheckVerdict::Wrong)
            .count();
        text += &match wrong {
            0 => format!("\nPassed: {} checks.\n", self.rows.len()),
            _ => format!(
                "\nNot passed: {wrong} of {} checks are wrong.\n",
                self.rows.len()
            ),
        };
        text += "\nDate: ____________________   Signed: ______________________________\n";
        tool.say(&json, text)?;
        Ok(())
    }
}

/// False if something is not as it should be.
pub(crate) async fn run(tool: &Tool, arguments: &Arguments) -> Done {
    let machine = Machine::load(&arguments.file)?;
    let mut page = Page::default();
    let line = arguments.line.scan(tool).await?;
    let looked = tool
        .unless_interrupted(compare(&machine, &line, &mut page))
        .await;
    line.close().await;
    let is_this_line = looked?;
    // A line of other devices is not brought up.
    if is_this_line && !machine.devices.is_empty() {
        let network = machine.on(arguments.line.network()?)?;
        let start = async { Ok(network.start().await) };
        match tool.unless_interrupted(start).await? {
            // A finding like others: the page says what is known by then.
            Err(error) => page.wrong("line", "bring-up", "failed", error.to_string()),
            Ok(net) => {
                let measure = measure(&machine, &net, arguments.seconds, &mut page);
                let measured = tool.unless_interrupted(measure).await;
                net.shutdown().await?;
                measured?;
            }
        }
    }
    page.show(tool, arguments)?;
    Ok(page.passed())
}

/// What the devices are and hold, before anything is configured; whether they are those of the file.
async fn compare(machine: &Machine, line: &Line, page: &mut Page) -> Result<bool, Failure> {
    let devices = line.devices();
    let mut is_this_line = devices.len() == machine.devices.len();
    for position in 0..machine.devices.len().max(devices.len()) {
        let what = format!("position {position}");
        match (machine.devices.get(position), devices.get(position)) {
            (Some(expected), Some(found)) => {
                let is_same = same_device(expected, found, page);
                is_this_line &= is_same;
                if is_same
                    && expected.kind.is_drive()
                    && let Some(sdo) = &found.sdo
                {
                    before(machine, expected, sdo, page).await?;
                    for (number, axis) in (1..).zip(&expected.axes) {
                        settings(sdo, number, &axis.name, page).await;
                    }
                }
            }
            (Some(expected), None) => page.wrong(
                &what,
                "device",
                "nothing",
                format!(
                    "expected \"{}\": is it switched on, and its cable plugged in?",
                    expected.name
                ),
            ),
            (None, Some(found)) => page.wrong(
                &what,
                "device",
                format!("{:#}", found.id),
                "it is not in the file: take it away, or add it by `servocrab init`",
            ),
            (None, None) => {}
        }
    }
    Ok(is_this_line)
}

fn same_device(expected: &Device, found: &LineDevice, page: &mut Page) -> bool {
    let what = format!("{} {}", found.id.position, found.id.name);
    if let Some(problem) = &found.problem {
        page.wrong(&what, "device", "does not reach PREOP", problem.to_string());
        return false;
    }
    let got = found.id.identity;
    let numbers = [
        ("vendor", expected.vendor, got.vendor),
        ("product code", expected.product, got.product),
        ("revision", expected.revision, got.revision),
        // Without a serial number in the file any will do.
        (
            "serial number",
            expected.serial,
            if expected.serial == 0 { 0 } else { got.serial },
        ),
        ("alias", expected.alias.into(), found.alias.into()),
    ];
    let wrong: Vec<_> = numbers
        .iter()
        .filter(|(_, expected, got)| expected != got)
        .map(|(name, expected, got)| format!("{name} {expected:08X}h, and it has {got:08X}h"))
        .collect();
    if !wrong.is_empty() {
        let change = format!("expected \"{}\" with {}", expected.name, wrong.join("; "));
        page.wrong(&what, "device", format!("{got}"), change);
        return false;
    }
    page.good(&what, "device", format!("{got}"));
    true
}

/// What a drive holds from whoever used it before, and where it differs from its maker's file.
async fn before(
    machine: &Machine,
    expected: &Device,
    sdo: &SdoHandle,
    page: &mut Page,
) -> Result<(), Failure> {
    let what = format!("{} {}", sdo.drive().position, expected.name);
    let types = [obj::OUTPUT_SYNC_TYPE, obj::INPUT_SYNC_TYPE];
    let mut left = Vec::new();
    for object in types {
        // By ETG.1020 2 and 3 are DC SYNC0 and SYNC1.
        if let Ok(held @ (2 | 3)) = sdo.read(object).await {
            left.push(format!("{} = {held}", object.address()));
        }
    }
    match (expected.assign_activate, left.is_empty()) {
        (None, false) => page.note(
            &what,
            "clock settings",
            left.join(", "),
            "an earlier program has left it synchronised by SYNC0, and this one does not use its clock: the bring-up sets it back \
             where the drive allows it; or set assign_activate",
        ),
        (None, true) => page.good(&what, "clock settings", "none left over"),
        (Some(word), _) => page.good(&what, "clock settings", format!("assign-activate {word:04X}h")),
    }
    if let Some(file) = machine.esi_of(expected) {
        let esi = Esi::load(&file)?;
        match esi.device(expected.product, expected.revision) {
            Err(error) => page.wrong(
                &what,
                "ESI file",
                "another device's",
                format!("{}: {error}", file.display()),
            ),
            Ok(device) => {
                let differences = device.compare(sdo).await?;
                match differences.is_empty() {
                    true => page.good(&what, "ESI file", "agrees with the drive"),
                    false => page.note(&what, "ESI file", "differs", differences.to_string()),
                }
            }
        }
    }
    Ok(())
}

/// What an object holds; nothing where the drive has none.
async fn held<T: Value + Number, A: Readable>(
    sdo: &SdoHandle,
    object: Object<T, A>,
    axis: u8,
) -> Option<T> {
    sdo.read(object.offset(AxisOffset::of_axis(axis)))
        .await
        .ok()
}

/// The line in OP, with all axes disabled.
async fn measure(
    machine: &Machine,
    net: &Network,
    seconds: u32,
    page: &mut Page,
) -> Result<(), Failure> {
    let cycle = Duration::from_micros(machine.cycle_us.into());
    page.good("line", "bring-up", "in OP; watchdogs armed and read back");
    for (position, device) in (0..).zip(&machine.devices) {
        if let Some(sdo) = net.sdo(position) {
            for (number, axis) in (1..).zip(&device.axes) {
                watchdog(&sdo, number, &axis.name, page).await;
            }
        }
    }
    standstill(machine, net, Duration::from_secs(seconds.into()), page).await?;
    let load = net.cable_load();
    let micros = |time: Duration| time.as_nanos() as f64 / 1e3;
    let found = format!(
        "{} frame(s) of {} bytes: {:.1} µs of {:.0} µs",
        load.frames,
        load.bytes,
        micros(load.time()),
        micros(cycle)
    );
    match load.shortest_cycle() <= cycle {
        true => page.good("line", "cable load", found),
        false => page.wrong(
            "line",
            "cable load",
            found,
            format!(
                "choose cycles of {:.0} µs at least, map less, or divide the line",
                micros(load.shortest_cycle())
            ),
        ),
    }
    Ok(())
}

/// What an option code holds, in words.
fn words(object: ObjectAddress, value: i16) -> String {
    let meaning = meaning::of(object, &value.to_le_bytes(), None);
    let meaning = meaning.map_or_else(String::new, |meaning| meaning.text);
    format!("{value}: {meaning}")
}

/// What an axis does when the process data stop, as the bring-up has set it.
async fn watchdog(sdo: &SdoHandle, axis: u8, name: &str, page: &mut Page) {
    let what = format!("axis {name}");
    match held(sdo, obj::ABORT_CONNECTION_OPTION, axis).await {
        None => page.note(
            &what,
            "watchdog 6007h",
            "no such object",
            "the drive's manual says what it does when the process data stop",
        ),
        Some(value) => {
            let found = words(obj::ABORT_CONNECTION_OPTION.address(), value);
            match AbortConnection::from_raw(value).stops() {
                true => page.good(&what, "watchdog 6007h", found),
                false => page.wrong(
                    &what,
                    "watchdog 6007h",
                    found,
                    "the axis may go on when the program dies: write 1, 2 or 3",
                ),
            }
        }
    }
}

/// How an axis stops, and what limits it.
async fn settings(sdo: &SdoHandle, axis: u8, name: &str, page: &mut Page) {
    let what = format!("axis {name}");
    match held(sdo, obj::QUICK_STOP_OPTION, axis).await {
        None => page.note(
            &what,
            "quick stop 605Ah",
            "no such object",
            "the drive's manual says how it stops",
        ),
        Some(value) => {
            let found = words(obj::QUICK_STOP_OPTION.address(), value);
            match QuickStopOption(value).stops_under_control() {
                true => page.good(&what, "quick stop 605Ah", found),
                false => page.wrong(
                    &what,
                    "quick stop 605Ah",
                    found,
                    "the axis coasts at a quick stop: write 2 or 6 for the quick stop ramp",
                ),
            }
        }
    }
    let limits = (
        held(sdo, obj::SOFTWARE_LIMIT_MIN, axis).await,
        held(sdo, obj::SOFTWARE_LIMIT_MAX, axis).await,
    );
    match limits {
        (Some(low), Some(high)) if low < high => {
            page.good(&what, "position limits 607Dh", format!("{low} to {high}"));
        }
        (Some(low), Some(high)) => page.note(
            &what,
            "position limits 607Dh",
            format!("{low} to {high}: off"),
            "an axis with ends needs limits, by 607Dh or by switches",
        ),
        _ => page.note(
            &what,
            "position limits 607Dh",
            "no such object",
            "an axis with ends needs limit switches",
        ),
    }
    match held(sdo, obj::MAX_PROFILE_VELOCITY, axis).await {
        None => page.note(
            &what,
            "velocity limit 607Fh",
            "no such object",
            "the program alone limits the velocity",
        ),
        Some(0 | u32::MAX) => page.note(
            &what,
            "velocity limit 607Fh",
            "off",
            "the program alone limits the velocity",
        ),
        Some(limit) => page.good(&what, "velocity limit 607Fh", limit.to_string()),
    }
    match held(sdo, obj::FOLLOWING_ERROR_WINDOW, axis).await {
        None => page.note(
            &what,
            "following error 6065h",
            "no such object",
            "the drive's manual says when it gives up",
        ),
        Some(0) | Some(u32::MAX) => page.note(
            &what,
            "following error 6065h",
            "off",
            "an axis that is blocked is not noticed: set the window to what the machine can bear",
        ),
        Some(window) => page.good(&what, "following error 6065h", window.to_string()),
    }
}

/// How still an axis stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Noise {
    lowest: i32,
    highest: i32,
    fastest: u32,
}

impl Noise {
    const fn of(position: i32, velocity: i32) -> Self {
        Self {
            lowest: position,
            highest: position,
            fastest: velocity.unsigned_abs(),
        }
    }

    fn add(self, position: i32, velocity: i32) -> Self {
        Self {
            lowest: self.lowest.min(position),
            highest: self.highest.max(position),
            fastest: self.fastest.max(velocity.unsigned_abs()),
        }
    }

    const fn span(self) -> u32 {
        self.highest.abs_diff(self.lowest)
    }

    /// Tolerances that this noise does not reach: twice what was seen.
    const fn suggested(self) -> (u32, u32) {
        let position = self.span().saturating_mul(2);
        (
            if position == 0 { 1 } else { position },
            self.fastest.saturating_mul(2),
        )
    }
}

/// What the axes show while nothing moves them, and what the line loses meanwhile.
async fn standstill(
    machine: &Machine,
    net: &Network,
    time: Duration,
    page: &mut Page,
) -> Result<(), Failure> {
    let clock = net.clock();
    let axes: Vec<_> = net.axes().collect();
    let mut noise: Vec<Option<Noise>> = vec![None; axes.len()];
    let (begun, before) = (clock.now(), net.statistics());
    while clock.next_cycle().await?.saturating_sub(begun) < time {
        for (axis, noise) in axes.iter().zip(&mut noise) {
            let status = axis.status();
            if status.age == 0 {
                let (position, velocity) = (status.position, status.velocity);
                *noise = Some(noise.map_or(Noise::of(position, velocity), |noise| {
                    noise.add(position, velocity)
                }));
            }
        }
    }
    for (axis, noise) in axes.iter().zip(noise) {
        let identity = axis.identity();
        let name = &identity.axis;
        let what = format!("axis {name}");
        let Some(noise) = noise else {
            page.wrong(
                &what,
                "noise at standstill",
                "no inputs came",
                "look for the cable that loses frames: `servocrab report`",
            );
            continue;
        };
        let (position, velocity) = noise.suggested();
        let found = format!(
            "{} counts, {} counts/s; suggested tolerances: position {position}, velocity {velocity}",
            noise.span(),
            noise.fastest
        );
        let position_in_line = identity.drive.position;
        let device = machine.devices.get(usize::from(position_in_line));
        let number =
            device.and_then(|device| (1..).zip(&device.axes).find(|(_, axis)| axis.name == *name));
        let window = match (net.sdo(position_in_line), number) {
            (Some(sdo), Some((number, _))) => held(&sdo, obj::POSITION_WINDOW, number).await,
            _ => None,
        };
        match window {
            Some(window) if window < noise.span() && window != 0 => page.wrong(
                &what,
                "noise at standstill",
                found,
                format!("the position window 6067h is {window}: moves would not be seen to arrive. Write {position} at least"),
            ),
            _ => page.good(&what, "noise at standstill", found),
        }
    }
    lost(&before, &net.statistics(), page);
    match net.port_errors().await {
        Err(error) => page.note("line", "port errors", "not readable", error.to_string()),
        Ok(devices) => {
            let broken = devices.iter().filter(|device| {
                device
                    .ports
                    .iter()
                    .any(|port| port.invalid_frames > 0 || port.lost_links > 0)
            });
            let broken: Vec<_> = broken.map(|device| device.position.to_string()).collect();
            match broken.is_empty() {
                true => page.good("line", "port errors", "none"),
                false => page.note(
                    "line",
                    "port errors",
                    format!("at position {}", broken.join(", ")),
                    "since power-up frames were damaged or links lost there: `servocrab report` shows which cable still does it",
                ),
            }
        }
    }
    Ok(())
}

fn lost(before: &Statistics, now: &Statistics, page: &mut Page) {
    let cycles = now.cycles - before.cycles;
    let lost = now.lost - before.lost;
    let wrong = now.wrong_working_counters - before.wrong_working_counters;
    let found = format!("{lost} frames lost, {wrong} wrong working counters in {cycles} cycles");
    match lost + wrong {
        0 => page.good("line", "losses", found),
        _ => page.wrong("line", "losses", found, "look for the cable or the computer that loses frames: `servocrab report`, `servocrab doctor`"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_suggested_tolerances_are_twice_the_noise_over_the_whole_range_of_positions() {
        let noise = Noise::of(3, 0).add(-2, -40).add(1, 25);
        assert_eq!(
            (noise.span(), noise.fastest, noise.suggested()),
            (5, 40, (10, 80))
        );
        assert_eq!(Noise::of(7, 0).suggested(), (1, 0));
        let whole = Noise::of(i32::MIN, i32::MIN).add(i32::MAX, 0);
        assert_eq!(whole.suggested(), (u32::MAX, u32::MAX));
    }
}
