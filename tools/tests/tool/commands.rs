//! The tool's commands, run as a user runs them: on simulated lines in their process, and over a veth pair.

use std::{
    io::{BufRead, BufReader},
    path::{Path, PathBuf},
    process::{Command, Output, Stdio},
    time::{Duration, Instant},
};

use crate::namespace::{Process, inside_namespace, run, simulated, simulated_with};
use serde_json::Value;

const TOOL: &str = env!("CARGO_BIN_EXE_servocrab");

fn command(arguments: &str) -> Command {
    let mut command = Command::new(TOOL);
    command.args(arguments.split_whitespace());
    command.stdin(Stdio::null());
    command
}

struct Ended {
    code: Option<i32>,
    output: String,
    errors: String,
}

fn ended(output: Output) -> Ended {
    Ended {
        code: output.status.code(),
        output: String::from_utf8(output.stdout).expect("text"),
        errors: String::from_utf8(output.stderr).expect("text"),
    }
}

/// Runs the tool to its end.
fn servocrab(arguments: &str) -> Ended {
    ended(command(arguments).output().expect("the tool starts"))
}

/// Runs it to an end with this exit code, and gives its output.
fn with_code(code: i32, arguments: &str) -> String {
    let Ended {
        code: got,
        output,
        errors,
    } = servocrab(arguments);
    assert_eq!(got, Some(code), "{arguments}: {output}{errors}");
    output
}

fn json(arguments: &str) -> Value {
    let text = with_code(0, &format!("--json {arguments}"));
    serde_json::from_str(&text).expect("one JSON document")
}

#[test]
fn a_scan_shows_each_device_with_its_pdos_and_axes() {
    let line = json("scan --sim coupler,generic,akd2g,io,sigma7");
    let seen: Vec<_> = line.as_array().unwrap().iter().collect();
    let axes: Vec<_> = seen
        .iter()
        .map(|device| device["axes"].as_u64().unwrap())
        .collect();
    assert_eq!(axes, [0, 1, 2, 0, 1]);
    assert_eq!(seen[2]["name"], "AKD2G");
    assert!(
        seen.iter()
            .all(|device| device["problems"].as_array().unwrap().is_empty())
    );
    let text = with_code(0, "scan --sim coupler,generic,akd2g");
    assert!(text.contains("1600h 1610h"), "{text}");
}

#[test]
fn without_a_line_or_with_a_wrong_argument_the_error_says_what_to_do_as_text_or_as_json() {
    let text = servocrab("scan");
    assert_eq!(text.code, Some(2));
    assert!(
        text.errors.starts_with("servocrab: which line?"),
        "{}",
        text.errors
    );
    for wrong in [
        "--json scan",
        "scan --json --sim nothing",
        "--json",
        "--json od read 6041h --sim io",
    ] {
        let ended = servocrab(wrong);
        assert_eq!(
            (ended.code, ended.output.as_str()),
            (Some(2), ""),
            "{wrong}"
        );
        let error: Value = serde_json::from_str(&ended.errors).expect("one JSON object");
        let text = error["error"].as_str().unwrap();
        assert!(
            !text.is_empty() && !text.starts_with("error: "),
            "{wrong}: {text}"
        );
    }
    let several = servocrab("od read 6041h --sim akd2g,generic").errors;
    assert!(
        several.contains("--drive POSITION:\n  0: AKD2G\n  1: CiA402"),
        "{several}"
    );
}

#[test]
fn values_are_shown_with_their_states_bits_and_names() {
    let word = &json("od --sim akd2g read 6041h 6841h")[1];
    assert_eq!(word["name"], "statusword");
    let meaning = &word["meaning"];
    assert!(
        meaning["text"]
            .as_str()
            .unwrap()
            .ends_with("h Switch on disabled"),
        "{meaning}"
    );
    let bits = meaning["bits"].as_array().unwrap();
    assert!(
        bits.iter()
            .any(|bit| bit["bit"] == 6 && bit["name"] == "switch on disabled")
    );
    let text = with_code(0, "od --sim generic read 605Ah 0x1600:1 1000h");
    assert!(text.contains("6040h:00, 16 bits: controlword"), "{text}");
    assert!(text.contains("servo drive (CiA 402)"), "{text}");
}

#[test]
fn objects_are_found_on_all_drives_written_and_watched() {
    let text = with_code(0, "od --sim coupler,generic,akd2g find statusword");
    assert!(
        text.contains("drive 1 \"CiA402\"\n") && text.contains("6841h:00"),
        "{text}"
    );
    assert!(with_code(0, "od --sim generic find nosuchobject").contains("no object has"));
    let written = ended(
        command("--json od --sim generic write")
            .args(["profile velocity", "12345"])
            .output()
            .unwrap(),
    );
    let written: Value = serde_json::from_str(&written.output).expect("JSON");
    assert_eq!(written[0]["value"], "12345");
    let watched = with_code(0, "od --sim generic watch 6041h --count 2 --every 1");
    assert!(watched.contains("Switch on disabled; bits"), "{watched}");
    let refused = servocrab("od --sim generic write 6041h 1");
    assert_eq!(refused.code, Some(2));
    assert!(refused.errors.contains("6041h:00"), "{}", refused.errors);
}

#[test]
fn a_reader_that_has_seen_enough_ends_the_tool_quietly() {
    let mut child = command("od --sim generic watch 6064h 6041h --every 0 --json")
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut line = String::new();
    let mut output = BufReader::new(child.stdout.take().unwrap());
    output.read_line(&mut line).unwrap();
    assert!(line.starts_with('{'), "{line}");
    drop(output);
    // The encoder dithers: each change is written, to nobody.
    let end = ended(child.wait_with_output().unwrap());
    assert_eq!((end.code, end.errors.as_str()), (Some(0), ""));
}

#[test]
fn an_interrupted_watch_ends_in_order() {
    let mut child = Process(
        command("od --sim generic watch 6064h --every 1")
            .stdout(Stdio::piped())
            .spawn()
            .unwrap(),
    );
    let mut output = BufReader::new(child.0.stdout.take().unwrap());
    output.read_line(&mut String::new()).unwrap();
    run("kill", &["-INT", &child.0.id().to_string()]);
    assert_eq!(child.0.wait().unwrap().code(), Some(0));
}

#[test]
fn the_report_measures_the_drives_of_a_line_and_draws_a_picture() {
    let directory = tempfile::tempdir().unwrap();
    let picture = directory.path().join("cycles.svg");
    let report = json(&format!(
        "report --sim akd2g,io --seconds 1 --svg {}",
        picture.display()
    ));
    assert!(report["counts"]["cycles"].as_u64().unwrap() > 0, "{report}");
    assert_eq!(report["drives"].as_array().unwrap().len(), 1);
    // Whether the phase holds with a reference clock is a matter of the computer: .ci/examples measures that.
    assert_eq!(report["clock"], Value::Null);
    assert!(
        std::fs::read_to_string(picture)
            .unwrap()
            .contains("round trip")
    );
    let none = servocrab("report --sim io --seconds 1");
    assert_eq!(
        (none.code, none.errors.as_str()),
        (Some(2), "servocrab: no drive was found on the line\n")
    );
    // It would be long: a minute, and nothing of it could be drawn.
    let begun = Instant::now();
    let nowhere = servocrab("report --sim akd2g --seconds 60 --svg /nope/cycles.svg");
    assert_eq!((nowhere.code, nowhere.output.as_str()), (Some(2), ""));
    let says = "servocrab: /nope/cycles.svg: ";
    assert!(nowhere.errors.starts_with(says), "{}", nowhere.errors);
    assert!(begun.elapsed() < Duration::from_secs(30));
}

/// The simulator of this workspace, as built with the tests.
fn simulator() -> PathBuf {
    let path = Path::new(TOOL).with_file_name("servocrab-sim");
    assert!(
        path.exists(),
        "{} is not built: run `cargo test --workspace`",
        path.display()
    );
    path
}

#[test]
fn a_following_error_is_in_the_history_with_the_makers_text_until_it_is_cleared() {
    if !inside_namespace(
        "commands::a_following_error_is_in_the_history_with_the_makers_text_until_it_is_cleared",
    ) {
        return;
    }
    let _line = simulated(&simulator(), &["akd2g"], 120, None);
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("alarms.toml");
    std::fs::write(&file, "8611h = \"F6001\"\n").unwrap();
    let alarms = format!("--interface master0 --alarms {}", file.display());
    assert_eq!(with_code(0, "history --interface master0"), "no errors\n");
    with_code(0, "od --interface master0 write 6065h 1");
    let moved = servocrab(
        "move --interface master0 --axis 0-1 --by 50000 --velocity 500000 --yes --watchdog-ms 2000",
    );
    assert_eq!(moved.code, Some(2), "{}", moved.output);
    let why = "with following error (statusword bit 13): 8611h (following error); the maker says: F6001 following error magnitude";
    assert!(moved.errors.contains(why), "{}", moved.errors);
    let shown = with_code(0, &format!("history {alarms}"));
    assert!(shown.contains("8611h (following error; F6001)"), "{shown}");
    // Shown once more, and gone after that.
    let refused = servocrab("history --interface master0 --clear");
    assert_eq!(refused.code, Some(2), "{}", refused.output);
    let record = json("history --interface master0 --clear --yes");
    assert_eq!(record["errors"][0]["code"], 0x8611);
    assert_eq!(
        json("history --interface master0"),
        serde_json::json!({"errors": [], "diagnosis": null})
    );
}

#[test]
fn what_differs_is_shown_before_a_replaced_drive_gets_its_parameters_and_its_alias() {
    let directory = tempfile::tempdir().unwrap();
    let place = |name: &str| directory.path().join(name);
    let (file, machine, kept) = (place("x.toml"), place("machine.toml"), place("kept.bin"));
    let from = file.display().to_string();
    with_code(0, &format!("params --sim sigma7 backup {from}"));
    with_code(0, &format!("init --sim sigma7 {}", machine.display()));
    let changed = |file: &Path, changes: &[(&str, &str)]| {
        let mut text = std::fs::read_to_string(file).unwrap();
        for (old, new) in changes {
            assert!(text.contains(old), "{old} is not in {text}");
            text = text.replacen(old, new, 1);
        }
        std::fs::write(file, text).unwrap();
    };
    // The old drive had another number, another limit and an alias.
    changed(
        &file,
        &[("serial = 0", "serial = 18"), ("2147483647", "900000")],
    );
    changed(
        &machine,
        &[("kind = \"sigma7\"", "kind = \"sigma7\"\nalias = 7")],
    );

    let replace = format!("replace --sim sigma7 --axis 0 --from {from}");
    let shown = with_code(0, &format!("{replace} --dry-run"));
    for part in ["00000012h", "900000", "nothing is written"] {
        assert!(shown.contains(part), "{part} is not in {shown}");
    }
    let refused = servocrab(&replace);
    assert_eq!(refused.code, Some(2));
    for part in ["00000012h", "900000", "--yes"] {
        assert!(refused.errors.contains(part), "{}", refused.errors);
    }
    let done = json(&format!("{replace} --yes"));
    assert_eq!(
        (&done["written"], &done["stored"]),
        (&1.into(), &true.into())
    );
    assert_eq!(done["alias"], Value::Null);

    let named = std::fs::read_to_string(&machine).unwrap();
    let axis = named.split("axes = [\"").nth(1).unwrap();
    let axis = axis.split('"').next().unwrap();
    let by_machine = format!(
        "replace --sim sigma7 --axis {axis} --machine {} --keep {} --from {from}",
        machine.display(),
        kept.display()
    );
    let done = json(&format!("{by_machine} --yes"));
    assert_eq!((&done["written"], &done["alias"]), (&1.into(), &7.into()));
    assert!(kept.exists(), "what was there is kept");
    let unknown = servocrab(&format!(
        "replace --sim sigma7 --axis q --from {from} --yes"
    ));
    assert!(unknown.errors.contains("--machine"), "{}", unknown.errors);

    for (old, new, why) in [
        (
            "revision = 0x00000001",
            "revision = 0x00000002",
            "higher revision alone",
        ),
        (
            "product = 0x53474437",
            "product = 0x53474438",
            "another kind of drive",
        ),
    ] {
        changed(&file, &[(old, new)]);
        let refused = servocrab(&format!("{replace} --yes"));
        assert_eq!(refused.code, Some(2));
        assert!(refused.errors.contains(why), "{}", refused.errors);
    }
}

#[test]
fn an_eeprom_is_read_written_and_compared_with_the_old_image_kept_beside() {
    if !inside_namespace(
        "commands::an_eeprom_is_read_written_and_compared_with_the_old_image_kept_beside",
    ) {
        return;
    }
    let slow = ["--sii-write-ms", "5"].map(str::to_owned);
    let _line = simulated_with(&simulator(), &["akd2g", "generic"], 120, &slow);
    let directory = tempfile::tempdir().unwrap();
    let place = |name: &str| directory.path().join(name);
    let eeprom = |work: &str| format!("eeprom --interface master0 --drive 1 {work}");
    let old = place("old.bin");
    let read = json(&eeprom(&format!("read {}", old.display())));
    assert_eq!((&read["bytes"], &read["alias"]), (&4096.into(), &0.into()));
    with_code(0, &eeprom(&format!("verify {}", old.display())));

    // Asked for; then the alias and its checksum are written, with all that was there kept.
    let kept = place("kept.bin");
    let alias = eeprom(&format!("alias 7 --keep {}", kept.display()));
    let refused = servocrab(&alias);
    assert_eq!(refused.code, Some(2));
    assert!(refused.errors.contains("--yes"), "{}", refused.errors);
    assert!(!kept.exists());
    let written = json(&format!("{alias} --yes"));
    assert_eq!(
        (&written["words"], &written["alias"], &written["in_force"]),
        (&2.into(), &7.into(), &false.into())
    );
    assert_eq!(std::fs::read(&kept).unwrap(), std::fs::read(&old).unwrap());
    let differs = with_code(1, &eeprom(&format!("verify {}", old.display())));
    assert!(differs.contains("0004h  0000h  0007h"), "{differs}");

    // What is kept is not replaced by something else.
    let other = servocrab(&format!("{} --yes", alias.replace("alias 7", "alias 8")));
    assert_eq!(other.code, Some(2));
    assert!(other.errors.contains("move it away"), "{}", other.errors);

    // The old one again: the place of what is kept is beside it.
    let text = with_code(0, &eeprom(&format!("write {} --yes", old.display())));
    assert!(text.contains("alias 0 is in force (0012h)"), "{text}");
    assert!(place("eeprom-1.old").exists());
    with_code(0, &eeprom(&format!("verify {}", old.display())));

    // The tool is killed while it writes: what it has left is invalid, and the kept image is written again, by the position.
    let mut bytes = std::fs::read(&old).unwrap();
    bytes[2048..].fill(0x5A);
    let long = place("long.bin");
    std::fs::write(&long, bytes).unwrap();
    let last = place("last.bin");
    let write = format!("write {} --keep {} --yes", long.display(), last.display());
    let mut killed = command(&eeprom(&write));
    let mut killed = Process(killed.stderr(Stdio::piped()).spawn().unwrap());
    let mut said = BufReader::new(killed.0.stderr.take().unwrap());
    let mut line = String::new();
    said.read_line(&mut line).unwrap();
    assert!(line.contains("leave the device switched on"), "{line}");
    // It needs 5 s and more for 1024 words.
    std::thread::sleep(Duration::from_secs(2));
    drop(killed);
    let left = place("left.bin");
    with_code(1, &eeprom(&format!("read {}", left.display())));
    let without_image = eeprom(&format!("alias 3 --keep {} --yes", left.display()));
    assert_eq!(servocrab(&without_image).code, Some(2));
    let restored = servocrab(&eeprom(&format!("write {} --yes", last.display())));
    assert_eq!(restored.code, Some(0), "{}", restored.errors);
    assert!(
        restored.errors.contains("it is taken by its position"),
        "{}",
        restored.errors
    );
    with_code(0, &eeprom(&format!("verify {}", old.display())));

    // Another drive's image, and a file that is none.
    let own = old.display();
    let foreign = servocrab(&format!(
        "eeprom --interface master0 --drive 0 write {own} --keep {} --yes",
        place("foreign").display()
    ));
    assert_eq!(foreign.code, Some(2));
    assert!(
        foreign.errors.contains("the image is of vendor"),
        "{}",
        foreign.errors
    );
    let mut bytes = std::fs::read(&old).unwrap();
    bytes[8] = 9;
    std::fs::write(&old, bytes).unwrap();
    let wrong = servocrab(&eeprom(&format!("write {} --yes", old.display())));
    assert_eq!(wrong.code, Some(2));
    assert!(
        wrong.errors.contains("the checksum of the SII image is"),
        "{}",
        wrong.errors
    );
}

#[test]
fn parameters_go_to_a_file_and_from_it_to_all_drives_of_its_kind() {
    if !inside_namespace("commands::parameters_go_to_a_file_and_from_it_to_all_drives_of_its_kind")
    {
        return;
    }
    let devices = ["generic", "akd2g", "generic", "sigma7"];
    let _line = simulated(&simulator(), &devices, 120, None);
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("drive.toml");
    let path = file.display();
    let params = |work: &str| format!("params --interface master0 {work}");
    with_code(0, &params(&format!("--drive 0 backup {path}")));
    // It is there now: replacing it is asked for.
    let again = servocrab(&params(&format!("--drive 0 backup {path}")));
    assert_eq!(again.code, Some(2));
    assert!(
        again.errors.contains("is there already") && again.errors.contains("--yes"),
        "{}",
        again.errors
    );
    with_code(0, &params(&format!("--drive 0 compare {path}")));

    // Another value of one, and one that every drive refuses.
    let text = std::fs::read_to_string(&file).unwrap();
    let at = text
        .find("object = \"6067h:00\"")
        .expect("the position window");
    let value = at + text[at..].find("value = ").unwrap();
    let end = value + text[value..].find('\n').unwrap();
    let mut text = format!("{}value = 4711{}", &text[..value], &text[end..]);
    text += "\n[[parameter]]\nobject = \"2FF0h:01\"\ntype = \"u16\"\nvalue = 1\n";
    std::fs::write(&file, text).unwrap();

    let compared = with_code(1, &params(&format!("--drive 0 compare {path}")));
    assert!(compared.contains("4711 (u32)"), "{compared}");
    let dry = with_code(0, &params(&format!("apply {path} --all --dry-run")));
    assert!(dry.contains("nothing is written; 4 would be"), "{dry}");
    // Neither the dry run nor a question that nobody can answer has written anything.
    let asked = servocrab(&params(&format!("apply {path} --all")));
    assert_eq!(asked.code, Some(2));
    assert!(
        asked.errors.contains("Write 4 parameters to 2 drive(s)?"),
        "{}",
        asked.errors
    );
    let compared = with_code(1, &params(&format!("--drive 2 compare {path}")));
    assert!(compared.contains("4711 (u32)"), "{compared}");

    let applied = with_code(
        1,
        &format!("--json {}", params(&format!("apply {path} --all --yes"))),
    );
    let applied: Value = serde_json::from_str(&applied).unwrap();
    let drives = applied.as_array().unwrap();
    assert_eq!(
        drives
            .iter()
            .map(|drive| &drive["position"])
            .collect::<Vec<_>>(),
        [0, 2]
    );
    for drive in drives {
        assert_eq!(drive["written"], serde_json::json!(["6067h:00"]));
        assert_eq!(drive["refused"][0]["object"], "2FF0h:01");
    }
    let compared = with_code(1, &params(&format!("--drive 2 compare {path}")));
    assert!(
        !compared.contains("4711") && compared.contains("2FF0h:01"),
        "{compared}"
    );

    // Of another kind: refused by name, before anything is asked or written.
    for work in ["apply", "restore"] {
        let other = servocrab(&params(&format!("--drive 1 {work} {path} --yes")));
        assert_eq!(other.code, Some(2));
        assert!(
            other.errors.contains("another kind of drive"),
            "{}",
            other.errors
        );
    }
    // A restore ends at what the drive refuses.
    let restored = servocrab(&params(&format!("--drive 0 restore {path} --yes")));
    assert_eq!(restored.code, Some(2));
    assert!(
        restored.output.contains("not written"),
        "{}",
        restored.output
    );
    assert!(!restored.errors.contains(" :"), "{}", restored.errors);
    assert!(with_code(0, &params("--drive 3 store --yes")).contains("stored"));
    assert!(with_code(0, &params("--drive 3 defaults --yes")).contains("switched off and on"));
    assert!(with_code(0, &params("--drive 0 store --dry-run")).contains("no such object"));
}

#[test]
fn a_backup_goes_into_what_a_link_names_and_leaves_nothing_beside_a_place_that_is_no_file() {
    let directory = tempfile::tempdir().unwrap();
    let (file, link) = (
        directory.path().join("of-today.toml"),
        directory.path().join("drive.toml"),
    );
    std::fs::write(&file, "").unwrap();
    std::os::unix::fs::symlink("of-today.toml", &link).unwrap();
    with_code(
        0,
        &format!("params --sim akd2g backup {} --yes", link.display()),
    );
    assert!(link.is_symlink(), "the link is still one");
    assert!(
        std::fs::read_to_string(&file)
            .unwrap()
            .contains("[[parameter]]")
    );

    let no_file = directory.path().join("directory");
    std::fs::create_dir(&no_file).unwrap();
    with_code(
        2,
        &format!("params --sim akd2g backup {} --yes", no_file.display()),
    );
    assert!(!directory.path().join("directory.new").exists());
}

#[test]
fn a_parameter_file_without_a_parameter_agrees_with_no_drive() {
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("cut-off.toml");
    std::fs::write(&file, "").unwrap();
    let file = file.display();
    for work in [
        format!("compare {file}"),
        format!("restore {file} --yes"),
        format!("apply {file} --yes"),
    ] {
        let ended = servocrab(&format!("params --sim akd2g {work}"));
        assert_eq!(ended.code, Some(2), "{work}: {}", ended.output);
        let says = format!("servocrab: {file} has no parameters\n");
        assert_eq!(ended.errors, says, "{work}");
    }
}

#[test]
fn a_command_that_asks_names_only_the_options_that_it_has() {
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("there");
    std::fs::write(&file, "").unwrap();
    let file = file.display();
    for asks in [
        "move --sim akd2g --axis 0-1 --by 500 --velocity 5000".to_owned(),
        "jog --sim akd2g --axis 0-1 --velocity 5000 --milliseconds 100".to_owned(),
        "home --sim akd2g --axis 0-1 --method 37".to_owned(),
        "params --sim akd2g store".to_owned(),
        format!("params --sim akd2g backup {file}"),
        format!("init --sim akd2g {file}"),
        format!("bundle --sim akd2g --out {file}"),
    ] {
        let asked = servocrab(&asks);
        assert_eq!(asked.code, Some(2), "{asks}");
        assert!(asked.errors.contains("--yes"), "{asks}: {}", asked.errors);
        let has = with_code(0, &format!("{asks} --help")).contains("--dry-run");
        assert_eq!(
            asked.errors.contains("--dry-run"),
            has,
            "{asks}: {}",
            asked.errors
        );
    }
}

#[test]
fn a_watch_that_ends_before_its_trigger_says_so() {
    let mut watch = command("watch --sim akd2g --for 1 0-1.position --trigger");
    let ended = ended(watch.arg("0-1.state == Fault").output().unwrap());
    assert_eq!(ended.output.lines().count(), 1, "{}", ended.output);
    assert_eq!(ended.code, Some(1), "{}{}", ended.output, ended.errors);
    assert!(ended.errors.contains("trigger"), "{}", ended.errors);
}

#[test]
fn every_drive_is_watched_and_moved_whatever_it_lacks() {
    for drive in ["akd2g", "pp2010", "ax2000", "sigma7", "generic"] {
        let watched = with_code(
            0,
            &format!("watch --sim {drive} --for 1 --every 100 0-1.position"),
        );
        assert!(watched.lines().count() > 1, "{drive}: {watched}");
        let moved = with_code(
            0,
            &format!(
                "move --sim {drive} --axis 0-1 --watchdog-ms 2000 --by 500 --velocity 5000 --yes"
            ),
        );
        assert!(
            moved.starts_with("reached, within the window of "),
            "{drive}: {moved}"
        );
    }
}

#[test]
fn a_signal_that_an_axis_has_not_is_not_looked_for_among_the_other_devices() {
    let wrong = servocrab("watch --sim akd2g --for 1 0-1.positon");
    assert_eq!(wrong.code, Some(2));
    assert!(!wrong.errors.contains("no io is named"), "{}", wrong.errors);
    assert!(wrong.errors.contains("positon"), "{}", wrong.errors);
}

#[test]
fn what_is_on_a_line_becomes_a_file_whose_simulated_line_becomes_the_same_file() {
    let test =
        "commands::what_is_on_a_line_becomes_a_file_whose_simulated_line_becomes_the_same_file";
    if !inside_namespace(test) {
        return;
    }
    let directory = tempfile::tempdir().unwrap();
    let place = |name: &str| directory.path().join(name).display().to_string();
    let (first, second) = (place("machine.toml"), place("again.toml"));
    let said = with_code(
        0,
        &format!("init --sim coupler,akd2g,io,sigma7,generic,ax2000 --clocks {first}"),
    );
    assert!(
        said.contains("6 device(s), of them 4 drive(s) with 5 axes and 1 with inputs or outputs"),
        "{said}"
    );
    let asked = servocrab(&format!("init --sim io {first}"));
    assert_eq!(asked.code, Some(2));
    assert!(
        asked.errors.contains("is there already"),
        "{}",
        asked.errors
    );

    let mut line = Process(
        command(&format!("sim {first} --interface slave0 --for 60"))
            .stdout(Stdio::piped())
            .spawn()
            .unwrap(),
    );
    let mut says = BufReader::new(line.0.stdout.take().unwrap());
    let mut listening = String::new();
    says.read_line(&mut listening).unwrap();
    assert_eq!(listening, "listening on slave0: 6 SubDevice(s)\n");
    with_code(0, &format!("init --interface master0 --clocks {second}"));
    let [first, second] = [first, second].map(|file| std::fs::read_to_string(file).unwrap());
    assert_eq!(first, second);
    assert!(
        first.contains("axes = [\"1-1\", \"1-2\"]") && first.contains("name = \"Inputs\""),
        "{first}"
    );
}

/// The line as `init --rust` writes it, compiled.
#[path = "../written/line.rs"]
#[allow(dead_code, reason = "the test looks at some of its names")]
mod line;

#[test]
fn the_line_as_rust_compiles_and_brings_up_the_line_that_it_was_made_of() {
    use servocrab::{Network, link::Wire};
    use servocrab_sim::{Segment, personality};
    let directory = tempfile::tempdir().unwrap();
    let rust = directory.path().join("line.rs");
    with_code(
        0,
        &format!(
            "init --sim coupler,akd2g,io,generic,pp2010 {}/machine.toml --rust={}",
            directory.path().display(),
            rust.display()
        ),
    );
    let written = std::fs::read_to_string(rust).unwrap();
    let kept = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/written/line.rs");
    if std::env::var_os("WRITE_LINE").is_some() {
        std::fs::write(&kept, &written).unwrap();
    }
    // Where there is no rustfmt it is laid out otherwise.
    let said = |text: &str| text.replace([' ', '\n', ','], "");
    assert_eq!(
        said(&written),
        said(&std::fs::read_to_string(kept).unwrap()),
        "WRITE_LINE=1 writes it"
    );

    let mut segment = Segment::new()
        .with(personality::coupler())
        .with(personality::akd2g())
        .with(personality::io_terminal())
        .with(personality::generic())
        .with(personality::pp2010());
    let wire = Wire::new(move |frame: &mut [u8], now| segment.process(frame, now));
    smol::block_on(async {
        let net = line::line(Network::builder().link(wire))
            .unwrap()
            .start()
            .await
            .unwrap();
        assert_eq!(net.axes().count(), 4);
        assert!(
            net.io("io 2")
                .unwrap()
                .output::<u16>(line::io_2::OUTPUTS)
                .is_ok()
        );
        net.shutdown().await.unwrap();
    });
}

#[test]
fn a_line_that_is_as_expected_passes_the_check_and_another_one_does_not() {
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("machine.toml");
    let path = file.display();
    with_code(0, &format!("init --sim akd2g,io,generic {path}"));
    // A computer that is busy with other things may lose frames: that is a finding, and no other part of the page.
    let checked = servocrab(&format!(
        "--json check --sim akd2g,io,generic --seconds 1 {path}"
    ));
    let page: Value = serde_json::from_str(&checked.output).unwrap();
    let of = |check: &str| -> Vec<&Value> {
        let all = page["checks"].as_array().unwrap().iter();
        all.filter(|row| row["check"] == check).collect()
    };
    for (check, rows) in [
        ("device", 3),
        ("watchdog 6007h", 3),
        ("quick stop 605Ah", 3),
        ("cable load", 1),
    ] {
        assert_eq!(of(check).len(), rows, "{check}: {page}");
        assert!(
            of(check).iter().all(|row| row["verdict"] == "good"),
            "{check}: {page}"
        );
    }
    // The simulated encoders dither by a count.
    let noise = of("noise at standstill");
    assert_eq!(noise.len(), 3);
    assert!(
        noise[0]["found"]
            .as_str()
            .unwrap()
            .contains("suggested tolerances: position ")
    );

    // Another device, one that is missing, and one too many: nothing is brought up.
    let other = with_code(1, &format!("check --sim akd2g,sigma7 {path}"));
    assert!(
        other.contains("expected \"16 outputs, 16 inputs\" with"),
        "{other}"
    );
    assert!(
        other.contains("position 2, device: expected \"CiA402\""),
        "{other}"
    );
    assert!(
        !other.contains("cable load") && other.contains("Not passed: 2 of 12"),
        "{other}"
    );
    let more = with_code(1, &format!("check --sim akd2g,io,generic,io {path}"));
    assert!(more.contains("it is not in the file"), "{more}");

    std::fs::write(&file, "device = 1").unwrap();
    let broken = servocrab(&format!("check --sim akd2g {path}"));
    assert_eq!(broken.code, Some(2));
    assert!(
        broken.errors.contains("machine.toml: "),
        "{}",
        broken.errors
    );
}

/// The last row that the simulator has written of an axis: controlword, statusword, position, velocity.
fn last_row(file: &Path, axis: &str) -> (u16, u16, f64, f64) {
    let text = std::fs::read_to_string(file).unwrap();
    let whole = &text[..text.rfind('\n').unwrap_or(0)];
    let rows = whole
        .lines()
        .map(|line| line.split(',').collect::<Vec<_>>());
    let mut of_axis = rows.filter(|row| row[2] == axis);
    let last = of_axis.next_back().expect("rows");
    let word = |text: &str| text.parse().unwrap();
    let number = |text: &str| text.parse().unwrap();
    (
        word(last[4]),
        word(last[5]),
        number(last[7]),
        number(last[8]),
    )
}

#[test]
fn an_axis_is_moved_jogged_and_homed_and_nothing_else_moves() {
    let test = "commands::an_axis_is_moved_jogged_and_homed_and_nothing_else_moves";
    if !inside_namespace(test) {
        return;
    }
    let directory = tempfile::tempdir().unwrap();
    let trace = directory.path().join("trace.csv");
    let mut line = simulated(&simulator(), &["akd2g"], 120, Some(&trace));
    // A computer that is busy with other things loses no drive.
    let axis = "--interface master0 --watchdog-ms 2000";
    let asked = servocrab(&format!(
        "move {axis} --axis 0-1 --by 5000 --velocity 50000"
    ));
    assert_eq!(asked.code, Some(2));
    assert!(
        asked.errors.contains("Is everybody clear of it?"),
        "{}",
        asked.errors
    );
    // Nobody knows what the position means.
    let refused = servocrab(&format!(
        "move {axis} --axis 0-1 --yes --to 5000 --velocity 50000"
    ));
    assert_eq!(refused.code, Some(2), "{}", refused.output);
    assert!(
        refused.errors.contains("--unreferenced"),
        "{}",
        refused.errors
    );
    let none = servocrab(&format!(
        "move {axis} --yes --axis 0-3 --by 1 --velocity 50000"
    ));
    assert!(
        none.errors
            .contains("there is no axis \"0-3\": the line has 0-1, 0-2"),
        "{}",
        none.errors
    );

    let moved = with_code(
        0,
        &format!("move {axis} --yes --axis 0-2 --to 5000 --unreferenced --velocity 50000"),
    );
    assert!(
        moved.starts_with("reached, within the window of "),
        "{moved}"
    );
    let jogged = json(&format!(
        "jog {axis} --yes --axis 0-2 --velocity 20000 --milliseconds 300"
    ));
    let travelled = jogged["position"].as_f64().unwrap() - jogged["from"].as_f64().unwrap();
    assert!(travelled > 1000.0, "{jogged}");
    let homed = json(&format!("home {axis} --yes --axis 0-2 --method 37"));
    assert_eq!(homed["referenced"], true, "{homed}");

    // Ctrl-C on the way: it stops and is disabled.
    let mut child = command(&format!(
        "move {axis} --yes --axis 0-2 --by 100000000 --velocity 50000"
    ))
    .stdout(Stdio::piped())
    .stderr(Stdio::piped())
    .spawn()
    .unwrap();
    let enabled = |word: u16| word & 0x6F == 0x27;
    while !enabled(last_row(&trace, "2").1) || last_row(&trace, "2").3 < 10_000.0 {
        assert!(
            child.try_wait().unwrap().is_none(),
            "it has ended before it moved"
        );
        std::thread::yield_now();
    }
    run("kill", &["-INT", &child.id().to_string()]);
    let mut errors = String::new();
    std::io::Read::read_to_string(&mut child.stderr.take().unwrap(), &mut errors).unwrap();
    assert_eq!(child.wait().unwrap().code(), Some(2));
    assert!(
        errors.contains("interrupted: stopped and disabled at "),
        "{errors}"
    );

    run("kill", &["-TERM", &line.0.id().to_string()]);
    assert!(line.0.wait().unwrap().success());
    let (_, status, _, velocity) = last_row(&trace, "2");
    assert!(
        !enabled(status) && velocity.abs() < 1000.0,
        "{status:04X}h, {velocity}"
    );
    let (_, status, position, _) = last_row(&trace, "1");
    assert!(
        !enabled(status) && position.abs() <= 2.0,
        "the other axis has stayed: {status:04X}h, {position}"
    );
}

#[test]
fn a_move_that_fails_says_that_its_axis_was_not_seen_to_stand() {
    let test = "commands::a_move_that_fails_says_that_its_axis_was_not_seen_to_stand";
    if !inside_namespace(test) {
        return;
    }
    let directory = tempfile::tempdir().unwrap();
    let trace = directory.path().join("trace.csv");
    let mut line = simulated(&simulator(), &["akd2g"], 120, Some(&trace));
    let by = "move --interface master0 --axis 0-1 --watchdog-ms 2000 --yes --unreferenced --velocity 50000 --by";
    // Once the axis has moved, the trace has rows of it.
    with_code(0, &format!("{by} 1000"));
    let mut child = command(&format!("{by} 100000000"))
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    while last_row(&trace, "1").3 < 10_000.0 {
        assert!(
            child.try_wait().unwrap().is_none(),
            "it has ended before it moved"
        );
        std::thread::yield_now();
    }
    // The drive is silent from here on: nobody can see what becomes of its axis.
    run("kill", &["-STOP", &line.0.id().to_string()]);
    let mut errors = String::new();
    std::io::Read::read_to_string(&mut child.stderr.take().unwrap(), &mut errors).unwrap();
    let code = child.wait().unwrap().code();
    run("kill", &["-CONT", &line.0.id().to_string()]);
    run("kill", &["-TERM", &line.0.id().to_string()]);
    line.0.wait().unwrap();
    assert_eq!(code, Some(2), "{errors}");
    assert!(
        errors.contains("not every axis was seen to stand: "),
        "{errors}"
    );
    assert!(!errors.contains("disabled at"), "{errors}");
}

#[test]
fn the_check_names_what_an_earlier_program_has_left_in_a_drive() {
    if !inside_namespace("commands::the_check_names_what_an_earlier_program_has_left_in_a_drive") {
        return;
    }
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("machine.toml");
    let path = file.display();
    let _line = simulated(&simulator(), &["akd2g"], 120, None);
    with_code(0, &format!("init --interface master0 {path}"));
    let verdicts = || -> Vec<(String, String, String)> {
        let checked = servocrab(&format!(
            "--json check --interface master0 --seconds 1 {path}"
        ));
        let page: Value = serde_json::from_str(&checked.output).expect("a page, whatever is wrong");
        let rows = page["checks"].as_array().unwrap().iter();
        let text = |value: &Value| value.as_str().unwrap().to_owned();
        rows.map(|row| {
            (
                text(&row["verdict"]),
                text(&row["what"]),
                text(&row["check"]),
            )
        })
        .collect()
    };
    let row = |verdict: &str, what: &str, check: &str| (verdict.into(), what.into(), check.into());
    let before = verdicts();
    assert!(
        before.contains(&row("good", "axis 0-2", "quick stop 605Ah")),
        "{before:?}"
    );
    assert!(
        before.contains(&row("note", "axis 0-2", "position limits 607Dh")),
        "{before:?}"
    );
    assert!(
        before.contains(&row("good", "0 AKD2G", "clock settings")),
        "{before:?}"
    );

    // The second axis coasts, and has limits; both axes are to follow a clock that this machine does not use.
    for (object, value) in [
        ("685Ah", "0"),
        ("687Dh:1", "-5000"),
        ("687Dh:2", "5000"),
        ("1C32h:1", "2"),
    ] {
        with_code(0, &format!("od --interface master0 write {object} {value}"));
    }
    let after = verdicts();
    assert!(
        after.contains(&row("wrong", "axis 0-2", "quick stop 605Ah")),
        "{after:?}"
    );
    assert!(
        after.contains(&row("good", "axis 0-1", "quick stop 605Ah")),
        "{after:?}"
    );
    assert!(
        after.contains(&row("good", "axis 0-2", "position limits 607Dh")),
        "{after:?}"
    );
    assert!(
        after.contains(&row("note", "0 AKD2G", "clock settings")),
        "{after:?}"
    );
}

#[test]
fn a_drive_of_a_makers_file_is_simulated_and_checked_by_that_file() {
    if !inside_namespace("commands::a_drive_of_a_makers_file_is_simulated_and_checked_by_that_file")
    {
        return;
    }
    let directory = tempfile::tempdir().unwrap();
    let place = |name: &str| directory.path().join(name).display().to_string();
    let (first, second) = (place("machine.toml"), place("again.toml"));
    let esi = Path::new(env!("CARGO_MANIFEST_DIR")).join("../sim/esi/akd2g.xml");
    let esi_file = esi.canonicalize().unwrap();
    let esi = esi_file.display();
    let said = with_code(0, &format!("init --sim akd2g --esi {esi} {first}"));
    assert!(said.contains("1 drive(s) with 2 axes"), "{said}");
    let mut line = Process(
        command(&format!("sim {first} --interface slave0 --for 60"))
            .stdout(Stdio::piped())
            .spawn()
            .unwrap(),
    );
    let mut says = BufReader::new(line.0.stdout.take().unwrap());
    says.read_line(&mut String::new()).unwrap();
    with_code(0, &format!("init --interface master0 --esi {esi} {second}"));
    let [first_text, second_text] =
        [&first, &second].map(|file| std::fs::read_to_string(file).unwrap());
    assert_eq!(first_text, second_text);
    assert!(first_text.contains("kind = \"esi\""), "{first_text}");
    // Beside the machine's file it is named by its way from there.
    std::fs::copy(&esi_file, directory.path().join("akd2g.xml")).unwrap();
    let third = place("third.toml");
    with_code(
        0,
        &format!("init --sim akd2g --esi {} {third}", place("akd2g.xml")),
    );
    let third_text = std::fs::read_to_string(&third).unwrap();
    assert!(third_text.contains("esi = \"akd2g.xml\""), "{third_text}");
    let page = servocrab(&format!(
        "--json check --interface master0 --seconds 1 {first}"
    ));
    let page: Value = serde_json::from_str(&page.output).expect("a page");
    let rows = page["checks"].as_array().unwrap();
    let file = rows
        .iter()
        .find(|row| row["check"] == "ESI file")
        .expect("a row");
    assert_eq!(file["verdict"], "good", "{page}");
    // A file that describes another drive.
    let other = first_text.replace("product = 0x414B4432", "product = 0x00000001");
    std::fs::write(&first, other).unwrap();
    let refused = servocrab(&format!("sim {first} --interface slave0 --for 1"));
    assert_eq!(refused.code, Some(2));
    let errors = refused.errors;
    assert!(
        errors.contains("device 0 \"AKD2G\": ")
            && errors.contains("there is no device of product 00000001h"),
        "{errors}"
    );
}

#[test]
fn init_cmds_of_a_makers_file_are_executed_or_refused_by_name() {
    if !inside_namespace("commands::init_cmds_of_a_makers_file_are_executed_or_refused_by_name") {
        return;
    }
    let directory = tempfile::tempdir().unwrap();
    let place = |name: &str| directory.path().join(name);
    let [esi, refused, machine, source] =
        ["drive.xml", "refused.xml", "machine.toml", "line.rs"].map(place);
    let sample = Path::new(env!("CARGO_MANIFEST_DIR")).join("../sim/esi/generic.xml");
    let sample = std::fs::read_to_string(sample).unwrap();
    let command = |transition: &str, index: &str, data: &str| {
        format!(
            "<InitCmd><Transition>{transition}</Transition><Index>#x{index}</Index><SubIndex>0</SubIndex>\
             <Data>{data}</Data></InitCmd>"
        )
    };
    let with = |commands: String| sample.replace("</CoE>", &format!("{commands}</CoE>"));
    let commands = [
        command("IP", "6067", "4D000000"),
        command("PS", "6068", "0700"),
        command("SO", "605A", "0600"),
    ];
    std::fs::write(&esi, with(commands.concat())).unwrap();
    std::fs::write(&refused, with(command("OS", "6068", "0700"))).unwrap();

    let _line = simulated(&simulator(), &["generic"], 60, None);
    let init = |esi: &Path| {
        servocrab(&format!(
            "init --interface master0 --esi {} --rust={} {}",
            esi.display(),
            source.display(),
            machine.display()
        ))
    };
    let why = "the InitCmd 6068h:00 of CiA 402 servo drive is for the transition OS";
    let unwritten = init(&refused);
    assert_eq!(unwritten.code, Some(2), "{}", unwritten.output);
    assert!(unwritten.errors.contains(why), "{}", unwritten.errors);
    assert!(!machine.exists());

    let written = init(&esi);
    assert_eq!(written.code, Some(0), "{}", written.errors);
    let source = std::fs::read_to_string(&source).unwrap();
    assert!(source.contains("DriveConfig::from_esi("), "{source}");
    let check = || {
        servocrab(&format!(
            "check --interface master0 --seconds 1 {}",
            machine.display()
        ))
    };
    let checked = check();
    for (object, value) in [("6067h", "77"), ("6068h", "7"), ("605Ah", "6")] {
        let read = json(&format!("od --interface master0 read {object}"));
        let all = format!("{read}: {}{}", checked.output, checked.errors);
        assert_eq!(read[0]["value"], value, "{all}");
    }
    std::fs::copy(&refused, &esi).unwrap();
    let checked = check();
    assert_eq!(checked.code, Some(2), "{}", checked.output);
    assert!(checked.errors.contains(why), "{}", checked.errors);
}

#[test]
fn a_question_at_a_terminal_is_answered_by_yes_by_no_and_by_ctrl_c() {
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("machine.toml");
    for (answer, code, said) in [
        ("n\n", 2, "the answer was not yes"),
        ("\x03", 2, "interrupted"),
        ("y\n", 0, "1 device(s)"),
    ] {
        std::fs::write(&file, "of the user").unwrap();
        // It gives the tool a terminal; without `exec` the Ctrl-C would also end a shell around the tool.
        let mut terminal = Command::new("script")
            .args([
                "-qec",
                &format!("exec {TOOL} init --sim io {}", file.display()),
                "/dev/null",
            ])
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .expect("script, of the system's own programs");
        let mut output = terminal.stdout.take().unwrap();
        let (mut text, mut byte) = (Vec::new(), [0]);
        while !text.ends_with(b"[y/N] ") {
            std::io::Read::read_exact(&mut output, &mut byte).expect("the question");
            text.push(byte[0]);
        }
        let mut input = terminal.stdin.take().unwrap();
        std::io::Write::write_all(&mut input, answer.as_bytes()).unwrap();
        let mut rest = String::new();
        std::io::Read::read_to_string(&mut output, &mut rest).unwrap();
        assert_eq!(terminal.wait().unwrap().code(), Some(code), "{rest}");
        assert!(rest.contains(said), "{rest}");
        let is_replaced = std::fs::read_to_string(&file).unwrap() != "of the user";
        assert_eq!(is_replaced, code == 0);
    }
}

#[test]
fn a_machine_s_file_gives_axes_their_names_and_units_and_the_tool_takes_them() {
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("machine.toml");
    let path = file.display();
    with_code(0, &format!("init --sim akd2g,io,generic {path}"));
    let text = std::fs::read_to_string(&file).unwrap();
    let named = text.replace(
        "axes = [\"0-1\", \"0-2\"]",
        "axes = [{ name = \"x\", unit = \"mm\", counts = 8192, per = 5 }, \"y\"]",
    );
    assert_ne!(text, named, "{text}");
    std::fs::write(&file, named).unwrap();
    let line = format!("--sim {path} --machine {path}");
    let moved = json(&format!(
        "move {line} --axis x --watchdog-ms 2000 --by 12.5 --velocity 50 --yes"
    ));
    let position = moved["position"].as_f64().unwrap();
    assert!((position - 12.5).abs() < 0.1, "{moved}");
    let watched = with_code(0, &format!("watch {line} --for 1 --every 500 x.position"));
    assert!(watched.contains("x.position [mm]"), "{watched}");
    // Counts are whole, and an axis without a unit has no others.
    let halves = servocrab(&format!(
        "move {line} --axis y --by 0.5 --velocity 50 --yes"
    ));
    assert_eq!(halves.code, Some(2));
    assert!(
        halves.errors.contains("no whole number"),
        "{}",
        halves.errors
    );
    let which = servocrab(&format!("move {line} --by 1 --velocity 50 --yes"));
    assert!(
        which
            .errors
            .contains("which axis? --axis x, --axis y, --axis 2-1"),
        "{}",
        which.errors
    );
    // Another line is refused.
    let other = servocrab(&format!(
        "move --sim generic --machine {path} --axis x --by 1 --velocity 50 --yes"
    ));
    assert_eq!(other.code, Some(2), "{}", other.output);
}

#[test]
fn a_line_without_the_last_drive_of_its_machine_s_file_is_refused_and_nothing_moves() {
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("machine.toml");
    let path = file.display();
    with_code(0, &format!("init --sim akd2g,io,generic {path}"));
    let moved = servocrab(&format!(
        "move --sim akd2g,io --machine {path} --axis 0-1 --by 100 --velocity 5000 --yes"
    ));
    assert_eq!(moved.code, Some(2), "{}", moved.output);
    assert!(moved.errors.contains("expected"), "{}", moved.errors);
    // Its axes are known all the same, and named where one is asked for.
    let which = servocrab(&format!(
        "move --sim akd2g,io --machine {path} --by 1 --velocity 50 --yes"
    ));
    assert!(which.errors.contains("--axis 2-1"), "{}", which.errors);
}

#[test]
fn a_drive_is_simulated_by_its_esi_file() {
    let esi = Path::new(env!("CARGO_MANIFEST_DIR")).join("../sim/esi/akd2g.xml");
    let line = with_code(0, &format!("scan --sim io,{}", esi.display()));
    assert!(line.contains("AKD2G"), "{line}");
    let chosen = with_code(0, &format!("scan --sim {}:0x414B4432", esi.display()));
    assert!(chosen.contains("AKD2G"), "{chosen}");
    let none = servocrab("scan --sim nothing");
    assert!(
        none.errors.contains("an ESI file (.xml)"),
        "{}",
        none.errors
    );
    let nowhere = servocrab("scan --sim nowhere.xml");
    assert!(nowhere.errors.contains("nowhere.xml"), "{}", nowhere.errors);
}

#[test]
fn a_watch_is_written_as_csv() {
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("watch.csv");
    let path = file.display();
    with_code(
        0,
        &format!("watch --sim generic --for 1 --every 100 0-1.position --csv {path}"),
    );
    let text = std::fs::read_to_string(&file).unwrap();
    assert!(
        text.starts_with("cycle,time [s],0-1.position [counts]\n"),
        "{text}"
    );
    assert!(text.lines().count() > 2, "{text}");
}

#[test]
fn a_bundle_that_cannot_be_written_says_why_and_nothing_else() {
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("bundle.zip");
    // No file may have a byte.
    let script = format!(
        "trap '' XFSZ; ulimit -f 0; exec {TOOL} bundle --sim generic --yes --out {}",
        file.display()
    );
    let bundle = ended(Command::new("sh").args(["-c", &script]).output().unwrap());
    assert_eq!(bundle.code, Some(2), "{}", bundle.output);
    let last = bundle.errors.lines().last().unwrap_or_default();
    assert!(last.contains("File too large"), "{}", bundle.errors);
    assert!(!bundle.errors.contains("ZipWriter"), "{}", bundle.errors);
    assert!(!file.exists());
}

#[test]
fn a_parameter_file_that_is_not_there_is_named_before_the_line_is_touched() {
    let refused = servocrab("params --interface nowhere0 apply nowhere.toml --yes");
    assert_eq!(refused.code, Some(2));
    assert!(
        refused.errors.contains("nowhere.toml") && !refused.errors.contains("nowhere0"),
        "{}",
        refused.errors
    );
}

#[test]
fn a_machine_s_file_is_replaced_as_a_whole_and_not_written_over() {
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("machine.toml");
    let kept = directory.path().join("kept.toml");
    std::fs::write(&file, "cycle_us = 2000\n").unwrap();
    std::fs::hard_link(&file, &kept).unwrap();
    with_code(0, &format!("init --sim generic {} --yes", file.display()));
    let text = |file: &Path| std::fs::read_to_string(file).unwrap();
    assert_eq!(text(&kept), "cycle_us = 2000\n");
    assert!(text(&file).contains("kind = \"generic\""));
}

/// Its PDOs hold what it wants, and cannot be filled.
#[test]
fn a_drive_that_the_profiles_objects_do_not_fit_is_moved_and_measured_by_its_makers_file() {
    let directory = tempfile::tempdir().unwrap();
    let [esi, other, machine] =
        ["drive.xml", "other.xml", "machine.toml"].map(|name| directory.path().join(name));
    let sample = Path::new(env!("CARGO_MANIFEST_DIR")).join("../sim/esi/generic.xml");
    let sample = std::fs::read_to_string(sample).unwrap();
    let fixed = sample
        .replace("Pdo Fixed=\"0\"", "Pdo Fixed=\"1\"")
        .replace("PdoConfig=\"1\"", "")
        .lines()
        .filter(|line| !line.contains("<Entry><Index>#x6084"))
        .map(|line| line.to_owned() + "\n")
        .collect::<String>()
        .replace(">#x607A</Index><SubIndex>0", ">0x607A</Index><SubIndex>0");
    std::fs::write(&esi, &fixed).unwrap();
    std::fs::write(&other, fixed.replace("#x44530402", "#x7")).unwrap();
    let (esi, other, machine) = (esi.display(), other.display(), machine.display());
    let moved = |by: &str| {
        servocrab(&format!(
            "move --sim {esi} {by} --by 500 --velocity 5000 --yes"
        ))
    };
    let without = servocrab(&format!("report --sim {esi} --seconds 1"));
    assert_eq!(without.code, Some(2), "{}", without.output);
    assert!(
        without
            .errors
            .contains("describe the drive by its maker's file, --esi FILE"),
        "{}",
        without.errors
    );
    for by in [
        format!("--esi {esi}"),
        format!("--esi {other}:7"),
        format!("--esi {esi}:44530402h:1"),
    ] {
        let moved = moved(&by);
        assert_eq!(moved.code, Some(0), "{by}: {}", moved.errors);
        assert!(
            moved.errors.contains("`0x607A` is no number"),
            "{}",
            moved.errors
        );
    }
    let absent = moved(&format!("--esi {other}"));
    assert!(
        absent.errors.contains("describes no device of this line"),
        "{}",
        absent.errors
    );
    let absent = moved(&format!("--esi {esi}:9"));
    assert!(
        absent
            .errors
            .contains("no device with product code 00000009h"),
        "{}",
        absent.errors
    );
    with_code(0, &format!("init --sim {esi} --esi {esi} {machine}"));
    assert_eq!(moved(&format!("--machine {machine}")).code, Some(0));
    with_code(0, &format!("report --sim {esi} --esi {esi} --seconds 1"));
    with_code(
        0,
        &format!("report --sim {esi} --machine {machine} --seconds 1"),
    );
    with_code(0, &format!("check --sim {esi} {machine} --seconds 1"));
    let held = servocrab(&format!("move --sim {esi} --esi {esi} --by 500 --yes"));
    assert_eq!(held.code, Some(0), "{}", held.errors);
}
