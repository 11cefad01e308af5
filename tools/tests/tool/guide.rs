//! Every command of the guide and of the tool's page, exactly as it stands there, in the order of the pages: on a veth pair named `eth0`, with
//! simulated drives on its other end.

use std::{
    collections::BTreeSet,
    fs,
    path::Path,
    process::{Command, Stdio},
};

use crate::namespace::{inside_namespace, simulated_on, veth_pair};

const TOOL: &str = env!("CARGO_BIN_EXE_servocrab");

fn read(page: &str) -> String {
    let docs = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs");
    fs::read_to_string(docs.join(page)).unwrap()
}

/// The pages of the guide, in the order of its first.
fn pages() -> Vec<String> {
    let first = read("guide/README.md");
    let names = first.split('(').filter_map(|rest| rest.split_once(')'));
    let names = names.filter_map(|(name, _)| name.ends_with(".md").then_some(name));
    names
        .filter(|name| !name.starts_with(".."))
        .map(|name| read(&format!("guide/{name}")))
        .collect()
}

/// The commands of a page: its console blocks and what stands between backticks in its text.
fn commands(page: &str) -> Vec<String> {
    let mut found = Vec::new();
    let mut block: Option<bool> = None;
    for line in page.lines() {
        if let Some(kind) = line.strip_prefix("```") {
            block = block.is_none().then_some(["sh", "console"].contains(&kind));
        } else if block == Some(true) {
            found.push(line.trim_start_matches("$ ").to_owned());
        } else if block.is_none() {
            found.extend(line.split('`').skip(1).step_by(2).map(str::to_owned));
        }
    }
    let program = |command: &str| command.trim_start_matches("sudo ").to_owned();
    let is_command = |command: &String| {
        ["servocrab ", "servocrab-sim ", "cargo "]
            .iter()
            .any(|program| command.starts_with(program))
    };
    found
        .iter()
        .map(|command| program(command))
        .filter(is_command)
        .collect()
}

/// Runs the commands in their order. Gives the kinds that ran.
fn run(commands: &[String]) -> BTreeSet<String> {
    veth_pair("eth0", "drive0");
    let program = Path::new(TOOL).with_file_name("servocrab-sim");
    let line = ["akd2g", "sigma7"];
    let _line = simulated_on("drive0", &program, &line, 300, &[]);
    let home = tempfile::tempdir().unwrap();

    let mut ran = BTreeSet::new();
    for command in commands {
        let Some(arguments) = command.strip_prefix("servocrab ") else {
            continue;
        };
        let output = Command::new(TOOL)
            .args(arguments.split_whitespace())
            .args(patience(arguments))
            .current_dir(&home)
            .env("XDG_RUNTIME_DIR", home.path())
            .stdin(Stdio::null())
            .output()
            .unwrap();
        let said = String::from_utf8_lossy(&output.stdout);
        let errors = String::from_utf8_lossy(&output.stderr);
        // A check of the line or of the computer says by its code whether all is well: this is no computer of a machine.
        let kind = arguments.split(' ').next().unwrap_or_default();
        let codes: &[i32] = match kind {
            "check" | "doctor" => &[0, 1],
            _ => &[0],
        };
        let code = output.status.code().unwrap_or(-1);
        assert!(codes.contains(&code), "{command}: {code}\n{said}{errors}");
        assert!(
            said.lines().count() > 2
                || ["init", "params", "move", "jog", "od", "eeprom"].contains(&kind),
            "{command}: {said}{errors}"
        );
        ran.insert(kind.to_owned());
        // Later commands read these.
        let written = match kind {
            "init" => Some("machine.toml"),
            "params" => Some("drive.toml"),
            _ => None,
        };
        if let Some(file) = written {
            let there = fs::metadata(home.path().join(file)).unwrap();
            assert!(there.len() > 100, "{file}");
        }
    }
    ran
}

#[test]
fn every_command_of_the_guide_does_what_the_page_says() {
    if !inside_namespace("guide::every_command_of_the_guide_does_what_the_page_says") {
        return;
    }
    let pages = pages();
    assert!(pages.len() > 4, "{} pages", pages.len());
    let commands: Vec<_> = pages.iter().flat_map(|page| commands(page)).collect();
    // One starts the simulated line, as here, and the tests of the workspace are run with this one.
    let simulator = "servocrab-sim --interface drive0";
    let tests = "cargo test -p servocrab-attach --test pick_and_place";
    for others in [simulator, tests] {
        assert!(commands.iter().any(|command| command == others), "{others}");
    }
    let ran = run(&commands);
    for kind in ["scan", "doctor", "report", "init", "params", "check", "od"] {
        assert!(ran.contains(kind), "{kind}: {ran:?}");
    }
}

#[test]
fn every_command_of_the_tools_page_does_what_it_says() {
    if !inside_namespace("guide::every_command_of_the_tools_page_does_what_it_says") {
        return;
    }
    let tool = read("tool.md");
    let prompts = tool.lines().filter_map(|line| line.strip_prefix("$ "));
    // It takes what the guide's page has written before.
    let service = commands(&read("guide/service.md"));
    let writes = |command: &String| command.contains(" init ") || command.contains(" backup ");
    let written = service.into_iter().filter(writes);
    let commands: Vec<_> = written.chain(prompts.map(str::to_owned)).collect();
    let ran = run(&commands);
    for kind in [
        "scan", "params", "check", "od", "move", "jog", "watch", "eeprom",
    ] {
        assert!(ran.contains(kind), "{kind}: {ran:?}");
    }
}

/// A computer that is busy with other tests loses no drive that moves.
fn patience(arguments: &str) -> &'static [&'static str] {
    match arguments.starts_with("move ") || arguments.starts_with("jog ") {
        true => &["--watchdog-ms", "2000"],
        false => &[],
    }
}
