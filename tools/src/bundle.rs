//! What support needs, in one zip: the versions, the computer, the line, its drives.
//!
//! Where a program shows the network of the interface, what it shows is taken, and it goes on. Else the line is scanned here. A part that
//! cannot be had is named with the reason, and the rest is written.

use std::{
    collections::BTreeSet,
    fmt::Display,
    fs::File,
    io::{self, ErrorKind, Read, Write},
    path::{Path, PathBuf},
    time::{SystemTime, UNIX_EPOCH},
};

use clap::Args;
use serde_json::{Value, json};
use servocrab::{bus::Line, parameters::NewFile};
use servocrab_attach::{ClientError, Program};
use zip::{CompressionMethod, ZipWriter, write::SimpleFileOptions};

use crate::{
    doctor,
    line::LineArguments,
    output::{Done, Failure, Tool, bar, table, told},
    params, scan,
};

/// Where a program shows the network of the interface, the program goes on, and its drives are only read. Else the line is reset and
/// read: whatever it was doing ends.
#[derive(Args)]
pub(crate) struct Arguments {
    #[command(flatten)]
    line: LineArguments,
    /// The zip file
    #[arg(long, value_name = "FILE", default_value = "servocrab-bundle.zip")]
    out: PathBuf,
    /// A log file to put in; may be given several times
    #[arg(long = "log", value_name = "FILE")]
    logs: Vec<PathBuf>,
    /// Replace a file that is there without a question
    #[arg(long)]
    yes: bool,
}

/// What is asked of a program.
const SHOWN: [(&str, &str); 7] = [
    ("line.json", "/v1/line"),
    ("ios.json", "/v1/ios"),
    ("axes.json", "/v1/axes"),
    ("statistics.json", "/v1/statistics"),
    ("events.json", "/v1/events"),
    ("grants.json", "/v1/grants"),
    ("metrics.txt", "/metrics"),
];
/// Seconds for each of the two measurements of the timer.
const MEASURED: u32 = 2;
/// Objects of a drive that are read; there are drives with tens of thousands.
const OBJECTS: usize = 2000;

pub(crate) async fn run(tool: &Tool, arguments: &Arguments) -> Done {
    // An argument that names no line is an error before anything takes its time.
    drop(arguments.line.network()?);
    let out = &arguments.out;
    if out.exists() {
        let question = format!("{} is there already. Replace it?", out.display());
        tool.agreed(arguments.yes, &question).await?;
    }
    // What cannot be written is an error before anything takes its time, too.
    let new = NewFile::create(out)?;
    let mut bundle = Bundle::default();
    bundle.put("versions.json", Ok::<_, Failure>(text(&versions())));
    let interface = arguments.line.interface();
    let examined = doctor::examined(tool, interface, MEASURED)?;
    bundle.put("doctor.json", Ok::<_, Failure>(text(&examined)));
    match arguments.line.program()? {
        Some(program) => {
            let read = async {
                of_program(&mut bundle, &program).await;
                Ok(())
            };
            tool.unless_interrupted(read).await?;
        }
        None => of_line(tool, &mut bundle, &arguments.line).await?,
    }
    let written = bundle.write(&new, &arguments.logs);
    let written = written.map_err(|error| format!("{}: {error}", out.display()))?;
    new.complete()?;
    let Written { parts, missing } = written;
    let rows: Vec<_> = parts
        .iter()
        .map(|(name, bytes)| [name.clone(), bytes.to_string()])
        .collect();
    let mut said = table(["part", "bytes"], &rows);
    for missing in &missing {
        said += &format!("not in it: {missing}\n");
    }
    said += &format!("{} parts in {}\n", parts.len(), out.display());
    let of_part = |(name, bytes): &(String, u64)| json!({"name": name, "bytes": bytes});
    let json = json!({
        "file": out.display().to_string(),
        "parts": parts.iter().map(of_part).collect::<Vec<_>>(),
        "missing": missing,
    });
    tool.say(&json, said)?;
    Ok(true)
}

fn versions() -> Value {
    let system = rustix::system::uname();
    let now = SystemTime::now().duration_since(UNIX_EPOCH);
    json!({
        "servocrab": env!("CARGO_PKG_VERSION"),
        "system": system.sysname().to_string_lossy(),
        "release": system.release().to_string_lossy(),
        "version": system.version().to_string_lossy(),
        "machine": system.machine().to_string_lossy(),
        "seconds_since_1970": now.unwrap_or_default().as_secs(),
    })
}

fn text(json: &Value) -> Vec<u8> {
    format!("{json:#}\n").into_bytes()
}

/// What a program shows of its network.
async fn of_program(bundle: &mut Bundle, program: &Program) {
    for (name, path) in SHOWN {
        let answer = program.get(path).await;
        bundle.put(name, answer);
    }
    let events = bundle.json("events.json");
    let events = events.as_array().map_or(&[][..], Vec::as_slice);
    for event in events.iter().filter(|event| event["has_black_box"] == true) {
        let number = &event["number"];
        let answer = program.get(&format!("/v1/events/{number}/black_box")).await;
        bundle.put(&format!("black_box/{number}.json"), answer);
    }
    let line = bundle.json("line.json");
    let drives = line["drives"].as_array().map_or(&[][..], Vec::as_slice);
    for position in drives.iter().filter_map(|drive| drive["position"].as_u64()) {
        objects(bundle, program, position).await;
    }
}

/// The objects of a drive with their bytes, or why there are none.
async fn objects(bundle: &mut Bundle, program: &Program, position: u64) {
    let name = format!("od/{position}.json");
    let list = program.get(&format!("/v1/od/{position}")).await;
    let list = list.and_then(|list| {
        let list: Result<Vec<Value>, _> = serde_json::from_slice(&list);
        list.map_err(|error| ClientError::Protocol(error.to_string()))
    });
    let mut list = match list {
        Ok(list) => list,
        Err(error) => return bundle.miss(&name, error),
    };
    let readable = |entry: &&mut Value| {
        let access = entry["access"].as_str().unwrap_or_default();
        !access.starts_with("wo") && !access.starts_with("no access")
    };
    let mut asked: Vec<_> = list.iter_mut().filter(readable).collect();
    let all = asked.len();
    if all > OBJECTS {
        bundle.miss(
            &name,
            format_args!("{all} objects can be read; the first {OBJECTS} were"),
        );
        asked.truncate(OBJECTS);
    }
    let (bar, of) = (bar("reading"), asked.len());
    let mut tell = told(&bar);
    for (done, entry) in asked.into_iter().enumerate() {
        tell(done, of);
        let (Some(index), Some(subindex)) = (entry["index"].as_u64(), entry["subindex"].as_u64())
        else {
            continue;
        };
        let path = format!("/v1/od/{position}/{index:04X}h/{subindex:02X}");
        match program.get(&path).await {
            Ok(answer) => {
                let answer: Value = serde_json::from_slice(&answer).unwrap_or_default();
                entry["bytes"] = answer["bytes"].clone();
            }
            // An object that cannot be read now is in the list with the reason.
            Err(ClientError::Refused { text, .. }) => entry["error"] = json!(text),
            Err(error) => {
                bundle.miss(&name, format_args!("{done} of {of} objects, then {error}"));
                break;
            }
        }
    }
    drop(tell);
    bar.finish_and_clear();
    // An object a line: there are thousands.
    let rows: Vec<_> = list.iter().map(Value::to_string).collect();
    let rows = format!("[\n{}\n]\n", rows.join(",\n"));
    bundle.put(&name, Ok::<_, Failure>(rows.into_bytes()));
}

/// What the line holds where no program shows it.
async fn of_line(
    tool: &Tool,
    bundle: &mut Bundle,
    arguments: &LineArguments,
) -> Result<(), Failure> {
    let line = match arguments.scan(tool).await {
        Ok(line) => line,
        Err(error) if tool.is_interrupted() => return Err(error),
        Err(error) => {
            bundle.miss("scan.json and parameters", error);
            return Ok(());
        }
    };
    let read = async {
        of_devices(bundle, &line).await;
        Ok(())
    };
    let read = tool.unless_interrupted(read).await;
    line.close().await;
    read
}

async fn of_devices(bundle: &mut Bundle, line: &Line) {
    let scanned = scan::json(line).await;
    bundle.put("scan.json", Ok::<_, Failure>(text(&scanned)));
    for device in line.devices() {
        let Some(sdo) = &device.sdo else { continue };
        let name = format!("parameters/{}.toml", device.id.position);
        let read = params::read_all(sdo).await;
        if let Ok(backup) = &read {
            for (object, code) in &backup.refused {
                bundle.miss(&name, format_args!("{object} cannot be read: {code}"));
            }
        }
        bundle.put(&name, read.map(|backup| backup.set.to_toml().into_bytes()));
    }
}

/// What goes into the file.
#[derive(Default)]
struct Bundle {
    parts: Vec<(String, Vec<u8>)>,
    /// The names of what could not be had, with the reasons.
    missing: Vec<String>,
}

/// What is in the file.
struct Written {
    /// Their names and lengths.
    parts: Vec<(String, u64)>,
    missing: Vec<String>,
}

impl Bundle {
    fn put(&mut self, name: &str, part: Result<Vec<u8>, impl Display>) {
        match part {
            Ok(bytes) => self.parts.push((name.to_owned(), bytes)),
            Err(error) => self.miss(name, error),
        }
    }

    fn miss(&mut self, name: &str, reason: impl Display) {
        self.missing.push(format!("{name}: {reason}"));
    }

    /// A part as JSON; null where it is none, or is not there.
    fn json(&self, name: &str) -> Value {
        let part = self.parts.iter().find(|(known, _)| known == name);
        part.and_then(|(_, bytes)| serde_json::from_slice(bytes).ok())
            .unwrap_or_default()
    }

    /// Writes the zip.
    fn write(mut self, out: &NewFile, logs: &[PathBuf]) -> Result<Written, Failure> {
        let mut zip = ZipWriter::new(out.file());
        match self.fill(&mut zip, logs) {
            Ok(parts) => {
                zip.finish()?;
                Ok(Written {
                    parts,
                    missing: self.missing,
                })
            }
            Err(error) => {
                // Dropped, it would try to end the file, and say on the error output that this failed too.
                std::mem::forget(zip);
                Err(error)
            }
        }
    }

    /// The names and lengths of what was put in.
    fn fill(
        &mut self,
        zip: &mut ZipWriter<&File>,
        logs: &[PathBuf],
    ) -> Result<Vec<(String, u64)>, Failure> {
        let options = SimpleFileOptions::default().compression_method(CompressionMethod::Deflated);
        let mut written = Vec::new();
        for (name, bytes) in &self.parts {
            zip.start_file(name, options)?;
            zip.write_all(bytes)?;
            written.push((name.clone(), bytes.len() as u64));
        }
        let mut names = BTreeSet::new();
        for log in logs {
            let name = free_name(&mut names, log);
            match put_log(zip, options, &name, log)? {
                Ok(bytes) => written.push((name, bytes)),
                Err(error) => self.miss(&name, format_args!("{}: {error}", log.display())),
            }
        }
        if !self.missing.is_empty() {
            let missing = self.missing.join("\n") + "\n";
            zip.start_file("missing.txt", options)?;
            zip.write_all(missing.as_bytes())?;
            written.push(("missing.txt".into(), missing.len() as u64));
        }
        Ok(written)
    }
}

/// The log's own name, with a number where another log has that name.
fn free_name(names: &mut BTreeSet<String>, log: &Path) -> String {
    let own = log.file_name().unwrap_or(log.as_os_str()).to_string_lossy();
    let mut name = format!("logs/{own}");
    let mut number = 2;
    while !names.insert(name.clone()) {
        name = format!("logs/{number}-{own}");
        number += 1;
    }
    name
}

/// Puts a log in and gives its length, or why it cannot be read.
fn put_log(
    zip: &mut ZipWriter<&File>,
    options: SimpleFileOptions,
    name: &str,
    log: &Path,
) -> Result<io::Result<u64>, Failure> {
    // A pipe that is opened waits for its writer.
    let opened = std::fs::metadata(log).and_then(|known| match known.is_file() {
        // A log that is written meanwhile has an end all the same.
        true => Ok((known.len(), File::open(log)?.take(known.len()))),
        false => Err(io::Error::new(ErrorKind::InvalidInput, "it is no file")),
    });
    let (length, mut log) = match opened {
        Ok(opened) => opened,
        Err(error) => return Ok(Err(error)),
    };
    let is_large = length >= u64::from(u32::MAX);
    zip.start_file(name, options.large_file(is_large))?;
    let (mut buffer, mut bytes) = (vec![0; 64 * 1024], 0);
    loop {
        let read = match log.read(&mut buffer) {
            Ok(0) => return Ok(Ok(bytes)),
            Ok(read) => read,
            Err(error) if error.kind() == ErrorKind::Interrupted => continue,
            Err(error) => {
                zip.abort_file()?;
                return Ok(Err(error));
            }
        };
        zip.write_all(buffer.get(..read).unwrap_or_default())?;
        bytes += read as u64;
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    #[test]
    fn two_logs_of_one_name_are_both_put_in_and_what_is_no_file_is_missing() {
        let directory = tempfile::tempdir().unwrap();
        let place = |name: &str| directory.path().join(name);
        fs::create_dir(place("old")).unwrap();
        fs::write(place("run.log"), "new").unwrap();
        fs::write(place("old/run.log"), "older").unwrap();
        let out = place("bundle.zip");
        // Nobody writes into it: whoever opened it would wait.
        let pipe = std::process::Command::new("mkfifo")
            .arg(place("pipe"))
            .status();
        assert!(pipe.unwrap().success());
        let logs = ["run.log", "old/run.log", "old", "nowhere", "pipe"].map(place);
        let new = NewFile::create(&out).unwrap();
        let Written { parts, missing } = Bundle::default().write(&new, &logs).unwrap();
        new.complete().unwrap();
        let names: Vec<_> = parts.iter().map(|(name, _)| name.as_str()).collect();
        assert_eq!(names, ["logs/run.log", "logs/2-run.log", "missing.txt"]);
        assert_eq!((parts[0].1, parts[1].1, missing.len()), (3, 5, 3));
        assert!(missing[0].starts_with("logs/old: "), "{missing:?}");
        let mut zip = zip::ZipArchive::new(File::open(out).unwrap()).unwrap();
        let mut text = String::new();
        let mut part = zip.by_name("logs/2-run.log").unwrap();
        part.read_to_string(&mut text).unwrap();
        assert_eq!(text, "older");
    }
}
