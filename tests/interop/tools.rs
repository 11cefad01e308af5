//! The programs that others publish with their masters: SOEM's `slaveinfo`, `eepromtool` and `simple_ng`, and ethercrab's `sdo-info`.
//!
//! Each program is the authors' own. What it prints is compared with `drives.json` and with the simulated device itself.

use std::{
    collections::BTreeMap,
    fs,
    path::Path,
    process::Command,
    time::{Duration, Instant},
};

use serde_json::Value;

use crate::{
    namespace::{inside_namespace, simulated},
    programs, turn,
};

/// Every device that `servocrab-sim` has, in the order of the line.
const DEVICES: [&str; 7] = [
    "coupler", "akd2g", "io", "pp2010", "ax2000", "sigma7", "generic",
];

/// Seconds after which the simulated segment ends by itself: `simple_ng` alone takes one minute.
const LONGEST: u32 = 600;

/// How long ethercrab's program may try again, which gives every frame 30 ms.
const PATIENCE: Duration = Duration::from_secs(60);

/// The station alias that `eepromtool` writes.
const ALIAS: u16 = 1234;

/// What a device should answer.
struct Expected {
    name: &'static str,
    row: Value,
}

impl Expected {
    fn text(&self, key: &str) -> &str {
        self.row[key].as_str().expect("a text")
    }

    fn bytes(&self, direction: usize) -> u64 {
        self.row["default_bytes"][direction]
            .as_u64()
            .expect("bytes")
    }

    fn has_coe(&self) -> bool {
        self.row["axes"].is_array()
    }

    /// It tells its dictionary by SDO information.
    fn tells(&self) -> bool {
        self.row["object_list"] == true
    }
}

fn table() -> Vec<Expected> {
    let text = fs::read_to_string(programs::table()).expect("the table is there");
    let mut rows: Value = serde_json::from_str(&text).expect("the table is JSON");
    DEVICES
        .map(|name| Expected {
            name,
            row: rows[name].take(),
        })
        .into()
}

/// Runs one of the programs to its end, which must be success; what it printed.
fn run(command: &mut Command) -> String {
    let output = command.output().expect("the program starts");
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(
        output.status.success(),
        "{command:?}: {}: {said}",
        output.status
    );
    said
}

/// The part of `slaveinfo`'s output about each device.
fn sections<'a>(said: &'a str, devices: &[Expected]) -> Vec<&'a str> {
    let found = format!("{} slaves found and configured.", devices.len());
    assert!(said.contains(&found), "{said}");
    assert!(
        said.ends_with("End slaveinfo, close socket\nEnd program\n"),
        "{said}"
    );
    let parts: Vec<_> = said.split("\nSlave:").collect();
    let (head, parts) = parts.split_first().expect("there is a head");
    assert!(
        !head.contains("Time:"),
        "an error before the devices: {said}"
    );
    assert_eq!(parts.len(), devices.len(), "{said}");
    for (part, device) in parts.iter().zip(devices) {
        for line in [
            format!(" Name:{}", device.text("order")),
            format!(" Output size: {}bits", 8 * device.bytes(0)),
            format!(" Input size: {}bits", 8 * device.bytes(1)),
            // SAFEOP.
            " State: 4".to_owned(),
            format!(
                " Man: {} ID: {} Rev: {}",
                device.text("vendor").to_lowercase(),
                device.text("product").to_lowercase(),
                device.text("revision").to_lowercase()
            ),
        ] {
            assert!(
                part.lines().any(|one| one == line),
                "no line {line:?}: {part}"
            );
        }
    }
    parts.to_vec()
}

/// `slaveinfo -map`: the entries of the PDOs are as many bits as the process data; an object that the dictionary tells has its name.
fn mapping(part: &str, device: &Expected) -> String {
    assert!(!part.contains("Time:"), "an error: {part}");
    let entries: Vec<Vec<&str>> = part
        .lines()
        .filter(|line| line.starts_with("  [0x"))
        .map(|line| line.split_whitespace().collect())
        .collect();
    let hexadecimal = |word: &str| u64::from_str_radix(word.trim_start_matches("0x"), 16);
    let bits: u64 = entries
        .iter()
        .map(|words| hexadecimal(words[2]).expect("bits"))
        .sum();
    assert_eq!(bits, 8 * (device.bytes(0) + device.bytes(1)), "{part}");
    let named = entries.iter().filter(|words| words.len() > 4).count();
    let names = device.tells() || !device.has_coe();
    assert_eq!(named, if names { entries.len() } else { 0 }, "{part}");
    format!("{} entries, {named} with type and name", entries.len())
}

/// `slaveinfo -sdo`: every object is listed by the name that it has, every value is read.
fn dictionary(place: usize, part: &str, device: &Expected) -> String {
    let errors: Vec<_> = part.lines().filter(|line| line.contains("Time:")).collect();
    if !device.has_coe() {
        assert!(errors.is_empty(), "{part}");
        return "not offered, has no CoE".to_owned();
    }
    if !device.tells() {
        // SOEM expected another message than an SDO abort.
        let refused = format!("PACKET slave:{place} index:0000.00 error:1");
        assert!(errors.len() == 1 && errors[0].ends_with(&refused), "{part}");
        return "not offered, refused by an SDO abort".to_owned();
    }
    assert!(errors.is_empty(), "{errors:?}");
    let listed: BTreeMap<_, _> = part
        .lines()
        .filter_map(|line| {
            let (index, rest) = line.strip_prefix("0x")?.split_once(' ')?;
            let name = rest.split('"').nth(1)?;
            Some((u16::from_str_radix(index, 16).ok()?, name))
        })
        .collect();
    let mut simulated = programs::device(device.name);
    let has: Vec<_> = simulated
        .dictionary()
        .into_iter()
        .map(|object| (object.index, object.name.to_string()))
        .collect();
    let count = format!("CoE Object Description found, {} entries.", has.len());
    assert!(part.contains(&count), "{part}");
    // SOEM keeps 40 characters of a name.
    let short = |name: &str| name.chars().take(40).collect::<String>();
    let listed: Vec<_> = listed
        .iter()
        .map(|(&index, name)| (index, short(name)))
        .collect();
    let has: Vec<_> = has
        .iter()
        .map(|(index, name)| (*index, short(name)))
        .collect();
    assert_eq!(listed, has);
    format!("{} objects", listed.len())
}

/// `eepromtool`: shows, reads, writes the same again, and writes an alias.
fn eeprom(program: &Path, place: usize, device: &Expected) -> [(&'static str, String); 3] {
    let tool = |arguments: &[&str]| {
        let said = run(Command::new(program)
            .arg("master0")
            .arg(place.to_string())
            .args(arguments));
        assert!(said.ends_with("End, close socket\nEnd program\n"), "{said}");
        said
    };
    let value = |said: &str, key: &str| {
        let found = said.lines().find_map(|line| {
            let (name, value) = line.split_once(':')?;
            (name.trim() == key).then(|| value.trim().to_owned())
        });
        found.unwrap_or_else(|| panic!("no {key}: {said}"))
    };
    let said = tool(&["-i"]);
    for (key, expected) in [
        ("Vendor ID", device.text("vendor")),
        ("Product Code", device.text("product")),
        ("Revision Number", device.text("revision")),
        ("calculated", &value(&said, "Checksum")),
    ] {
        assert_eq!(value(&said, key), expected, "{key}: {said}");
    }
    let file = program.with_file_name(format!("{}.bin", device.name));
    let name = file.to_str().expect("the target directory has a name");
    let has = |image: &[u8]| {
        tool(&["-r", name]);
        let read = fs::read(&file).expect("it wrote what it read");
        // What follows the image is empty.
        assert!(read.starts_with(image), "the EEPROM of {}", device.name);
        read.len()
    };
    let mut simulated = programs::device(device.name);
    let size = has(simulated.eeprom());
    let written = tool(&["-w", name]);
    assert!(written.contains("Total EEPROM write time"), "{written}");
    has(simulated.eeprom());
    let written = tool(&["-walias", &ALIAS.to_string()]);
    let success = format!("Alias {ALIAS:04X} written successfully to slave {place}");
    assert!(written.contains(&success), "{written}");
    simulated.set_alias(ALIAS);
    has(simulated.eeprom());
    [
        ("eepromtool_i", "identity and checksum".to_owned()),
        ("eepromtool_r", format!("{size} bytes")),
        ("eepromtool_w", "the image, and an alias".to_owned()),
    ]
}

/// `simple_ng`: OP, ten thousand cycles, back to INIT.
fn cycles(program: &Path, devices: &[Expected]) -> String {
    let said = run(Command::new(program).arg("master0"));
    let sum = |direction| devices.iter().map(|one| one.bytes(direction)).sum::<u64>();
    for part in [
        &format!("{} slaves found\n", devices.len()),
        &format!("mapped {}O+{}I bytes", sum(0), sum(1)),
        " all slaves are now operational\n",
        "Requesting init state on all slaves... done\nClose socket... done\n",
    ] {
        assert!(said.contains(part), "no {part:?}");
    }
    // Outputs count twice in the working counter of an LRW, inputs once.
    let counts = |one: &Expected| 2 * u64::from(one.bytes(0) > 0) + u64::from(one.bytes(1) > 0);
    let right = format!("WKC {}  O:", devices.iter().map(counts).sum::<u64>());
    let iterations: Vec<_> = said
        .split(['\r', '\n'])
        .filter(|line| line.starts_with("Iteration "))
        .collect();
    let good = iterations
        .iter()
        .filter(|line| line.contains(&right))
        .count();
    println!(
        "simple_ng: {good} of {} with the right working counter",
        iterations.len()
    );
    // A busy machine may let a watchdog expire: then it brings the device back to OP, and the last cycle is right again.
    let last = iterations.last().expect("there were cycles");
    assert!(
        last.starts_with("Iteration 10000:") && last.contains(&right),
        "{last}"
    );
    "in OP, 10000 exchanges".to_owned()
}

/// Keeps what was seen of each device, by program.
fn keep(master: &str, devices: &[Expected], seen: &[Vec<(&str, String)>]) {
    for (device, seen) in devices.iter().zip(seen) {
        let lines: Vec<_> = seen
            .iter()
            .map(|(check, seen)| format!("ok {check}: {seen}"))
            .collect();
        println!("{master} on {}: {lines:#?}", device.name);
        programs::report(&format!("{master}-{}", device.name), &lines);
    }
}

#[test]
fn soems_tools_run_through_on_a_line_of_every_device() {
    let Some(tools) = programs::soem_tools() else {
        return;
    };
    let simulator = programs::simulator();
    let _turn = turn();
    if !inside_namespace("tools::soems_tools_run_through_on_a_line_of_every_device") {
        return;
    }
    let devices = table();
    let _simulator = simulated(&simulator, &DEVICES, LONGEST, None);
    let slaveinfo = |option| run(Command::new(tools.join("slaveinfo")).args(["master0", option]));
    let sdo = slaveinfo("-sdo");
    let map = slaveinfo("-map");
    let mut seen = Vec::new();
    let parts = sections(&sdo, &devices)
        .into_iter()
        .zip(sections(&map, &devices));
    for ((place, device), (sdo, map)) in (1..).zip(&devices).zip(parts) {
        seen.push(vec![
            ("slaveinfo_sdo", dictionary(place, sdo, device)),
            ("slaveinfo_map", mapping(map, device)),
        ]);
    }
    let in_op = cycles(&tools.join("simple_ng"), &devices);
    for ((place, device), seen) in (1..).zip(&devices).zip(&mut seen) {
        seen.push(("simple_ng", in_op.clone()));
        seen.extend(eeprom(&tools.join("eepromtool"), place, device));
    }
    keep("tools", &devices, &seen);
}

#[test]
fn ethercrabs_sdo_info_runs_through_on_every_device() {
    let Some(program) = programs::sdo_info() else {
        return;
    };
    let simulator = programs::simulator();
    let _turn = turn();
    if !inside_namespace("tools::ethercrabs_sdo_info_runs_through_on_every_device") {
        return;
    }
    let devices = table();
    let mut seen = Vec::new();
    for device in &devices {
        let told = sdo_info(&program, &simulator, device);
        seen.push(vec![("sdo_info", told)]);
    }
    keep("ethercrab", &devices, &seen);
}

/// `sdo-info` on one device: how many objects of each kind, and their indices.
fn sdo_info(program: &Path, simulator: &Path, device: &Expected) -> String {
    let begun = Instant::now();
    let output = loop {
        let _simulator = simulated(simulator, &[device.name], LONGEST, None);
        let output = Command::new(program)
            .arg("master0")
            .env("RUST_BACKTRACE", "0")
            .output()
            .expect("the program starts");
        let errors = String::from_utf8_lossy(&output.stderr);
        if !errors.contains("Timeout") || begun.elapsed() > PATIENCE {
            break output;
        }
        println!("sdo-info on {}: {errors}, once more", device.name);
    };
    let said = String::from_utf8_lossy(&output.stdout);
    let errors = String::from_utf8_lossy(&output.stderr);
    let name = format!("{}:\n", device.text("order"));
    assert!(said.starts_with(&name), "{said}{errors}");
    if device.has_coe() && !device.tells() {
        // It takes the SDO abort for SDO information that it cannot decode, and ends.
        assert_eq!(
            (said.as_ref(), errors.trim()),
            (&*name, "Error: Wire(InvalidValue)")
        );
        return "not offered, refused by an SDO abort".to_owned();
    }
    assert!(output.status.success(), "{said}{errors}");
    assert!(errors.contains("shutdown complete"), "{errors}");
    let has: Vec<_> = if device.has_coe() {
        let mut simulated = programs::device(device.name);
        let objects = simulated.dictionary();
        objects.into_iter().map(|object| object.index).collect()
    } else {
        Vec::new()
    };
    let all = format!("    all: {}\n", has.len());
    assert!(said.contains(&all), "{said}");
    let indices: Vec<_> = has.iter().map(|index| format!("{index:#06x}")).collect();
    let addresses = format!("  addresses: [{}]\n", indices.join(", "));
    assert!(said.contains(&addresses), "{said}");
    if has.is_empty() {
        return "not offered, has no CoE".to_owned();
    }
    format!("{} objects", has.len())
}
