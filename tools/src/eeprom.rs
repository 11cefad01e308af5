//! The EEPROM of a device: read into a file, compared with one, written from one; its station alias.

use std::{
    fs::File,
    io::Read,
    path::{Path, PathBuf},
};

use clap::{Args, Subcommand};
use serde_json::{Value, json};
use servocrab::{
    bus::{EepromAccessError, EepromContent, ImageKind, Line},
    parameters::NewFile,
    sii::SiiImage,
};

use crate::{
    line::{DriveArguments, LineArguments, found},
    output::{Done, Failure, Tool, table},
};

const LONGEST: u64 = SiiImage::LONGEST as u64;
/// The most words that are shown of a difference.
const SHOWN: usize = 16;

/// The line is reset, and its drives are in PREOP: nothing moves. Refused where a program has the interface.
#[derive(Args)]
pub(crate) struct Arguments {
    #[command(flatten)]
    line: LineArguments,
    #[command(flatten)]
    drive: DriveArguments,
    #[command(subcommand)]
    work: Work,
}

#[derive(Subcommand)]
enum Work {
    /// Reads the EEPROM into a file
    Read {
        /// The file, as SOEM's eepromtool has it too
        file: PathBuf,
        /// Replace a file that is there without a question
        #[arg(long)]
        yes: bool,
    },
    /// Compares the EEPROM with a file; ends with 1 if they differ
    Verify {
        /// The file
        file: PathBuf,
    },
    /// Writes an image; each word is read back
    Write {
        /// The image
        file: PathBuf,
        /// Write it to a device of another vendor or product, too
        #[arg(long)]
        force: bool,
        #[command(flatten)]
        consent: Consent,
    },
    /// Writes the configured station alias
    Alias {
        /// The alias; 0 for none
        alias: u16,
        #[command(flatten)]
        consent: Consent,
    },
}

#[derive(Args)]
struct Consent {
    /// Where what is in the EEPROM is kept before anything is written [default: eeprom-POSITION.old, beside the image]
    #[arg(long, value_name = "FILE")]
    keep: Option<PathBuf>,
    /// Write without a question
    #[arg(long)]
    yes: bool,
}

/// Does it; false if file and EEPROM differ, or the EEPROM that was read holds no valid image.
pub(crate) async fn run(tool: &Tool, arguments: &Arguments) -> Done {
    match &arguments.work {
        Work::Read { file, yes } => {
            if file.exists() {
                let question = format!("{} is there already. Replace it?", file.display());
                tool.agreed(*yes, &question).await?;
            }
            let (line, before) = read(tool, arguments).await?;
            line.close().await;
            saved(tool, &before, file)
        }
        Work::Verify { file } => {
            // One that cannot be used takes no line.
            let bytes = file_bytes(file)?;
            let (line, before) = read(tool, arguments).await?;
            line.close().await;
            compared(tool, &before, &bytes, file)
        }
        Work::Write {
            file,
            force,
            consent,
        } => {
            let image = SiiImage::new(file_bytes(file)?)?;
            let kind = match force {
                true => ImageKind::Any,
                false => ImageKind::Same,
            };
            let (line, before) = read(tool, arguments).await?;
            let keep = consent.place(before.position(), file);
            write(tool, line, &before, &image, kind, &keep, consent.yes).await
        }
        Work::Alias { alias, consent } => {
            let (line, before) = read(tool, arguments).await?;
            let keep = consent.place(before.position(), Path::new(""));
            let image = based_on(&before, &keep)?.with_alias(*alias);
            let kind = ImageKind::Same;
            write(tool, line, &before, &image, kind, &keep, consent.yes).await
        }
    }
}

/// The line, and what the EEPROM of the device holds.
async fn read(tool: &Tool, arguments: &Arguments) -> Result<(Line, EepromContent), Failure> {
    if arguments.line.program()?.is_some() {
        return Err("a running program has the line: end it first".into());
    }
    let line = arguments.line.scan(tool).await?;
    let device = arguments.drive.device(&found(&line))?;
    let position = device.id.position;
    let read = async { Ok(line.read_eeprom(position).await?) };
    let before = tool.unless_interrupted(read).await?;
    let writes = matches!(arguments.work, Work::Write { .. } | Work::Alias { .. });
    if let (true, Err(why)) = (writes, before.image()) {
        let unknown = format!(
            "the EEPROM of the device at position {position} holds no valid image ({why}), and does not say what device this is"
        );
        if arguments.drive.drive.is_none() {
            return Err(format!("{unknown}: name it by its position, --drive {position}").into());
        }
        tool.note(format_args!("{unknown}: it is taken by its position"));
    }
    Ok((line, before))
}

impl Consent {
    fn place(&self, position: u16, image: &Path) -> PathBuf {
        let beside = || image.with_file_name(format!("eeprom-{position}.old"));
        self.keep.clone().unwrap_or_else(beside)
    }
}

/// The bytes of a file that may be an image.
fn file_bytes(file: &Path) -> Result<Vec<u8>, Failure> {
    let named = |error: &dyn std::fmt::Display| format!("{}: {error}", file.display());
    let mut bytes = Vec::new();
    let opened = File::open(file).and_then(|open| open.take(LONGEST + 1).read_to_end(&mut bytes));
    match opened {
        Ok(length) if length as u64 > LONGEST => {
            Err(named(&format_args!("an image has at most {LONGEST} bytes")).into())
        }
        Ok(_) => Ok(bytes),
        Err(error) => Err(named(&error).into()),
    }
}

fn saved(tool: &Tool, before: &EepromContent, file: &Path) -> Done {
    NewFile::write(file, before.bytes())?;
    let (bytes, image) = (before.bytes().len(), before.image());
    let json = json!({
        "bytes": bytes,
        "alias": image.as_ref().ok().map(SiiImage::alias),
        "problem": image.as_ref().err().map(ToString::to_string),
    });
    let mut text = format!("{bytes} bytes in {}\n", file.display());
    match &image {
        Ok(image) => text += &format!("{}, alias {}\n", image.identity(), image.alias()),
        Err(problem) => text += &format!("no valid image: {problem}\n"),
    }
    tool.say(&json, text)?;
    Ok(image.is_ok())
}

fn compared(tool: &Tool, before: &EepromContent, file: &[u8], path: &Path) -> Done {
    let words = |bytes: &[u8]| -> Vec<u16> {
        let pairs = bytes.chunks(2);
        pairs
            .map(|pair| {
                pair.iter()
                    .rev()
                    .fold(0, |word, byte| word << 8 | u16::from(*byte))
            })
            .collect()
    };
    // What the device has behind the end of the file is none of the file's.
    let (file, held) = (words(file), words(before.bytes()));
    let held = |word: usize| held.get(word).copied();
    let differ = file
        .iter()
        .enumerate()
        .filter(|(word, value)| held(*word) != Some(**value));
    let shown = |word: usize, value: &u16| {
        let held = held(word).map_or("none".into(), |held| format!("{held:04X}h"));
        [format!("{word:04X}h"), format!("{value:04X}h"), held]
    };
    let rows: Vec<_> = differ.map(|(word, value)| shown(word, value)).collect();
    let text = match rows.len() {
        0 => format!("{} and the EEPROM agree\n", path.display()),
        count => {
            let first = rows.get(..SHOWN).unwrap_or(&rows);
            table(["word", "file", "device"], first) + &format!("{count} words differ\n")
        }
    };
    let each = rows
        .iter()
        .map(|[word, file, device]| json!({"word": word, "file": file, "device": device}));
    tool.say(&each.collect::<Value>(), text)?;
    Ok(rows.is_empty())
}

/// The image of which the alias is changed: what is in the EEPROM, or what was kept before a write that was interrupted.
fn based_on(before: &EepromContent, keep: &Path) -> Result<SiiImage, Failure> {
    match before.image() {
        Ok(image) => Ok(image),
        Err(_) if keep.exists() => Ok(SiiImage::new(file_bytes(keep)?)?),
        Err(_) => Err("write an image first, with `eeprom write`".into()),
    }
}

async fn write(
    tool: &Tool,
    line: Line,
    before: &EepromContent,
    image: &SiiImage,
    kind: ImageKind,
    keep: &Path,
    yes: bool,
) -> Done {
    let position = before.position();
    let id = line
        .devices()
        .get(usize::from(position))
        .map(|device| device.id.to_string());
    let question = format!(
        "Write the EEPROM of {} ({}, alias {})?",
        id.unwrap_or_default(),
        image.identity(),
        image.alias()
    );
    tool.agreed(yes, &question).await?;
    kept(tool, before, keep)?;
    tool.note("writing: leave the device switched on");
    // Ctrl-C comes too late from here on: a part of an image is none.
    let written = match line.write_eeprom(before, image, kind).await {
        Ok(written) => written,
        Err(error @ (EepromAccessError::Write { .. } | EepromAccessError::Ended)) => {
            let keep = keep.display();
            return Err(format!(
                "{error}. What was there is in {keep}: `servocrab eeprom write {keep} --drive {position}`"
            )
            .into());
        }
        Err(error) => return Err(error.into()),
    };
    let in_force = written.alias == image.alias();
    let json = json!({
        "words": written.words,
        "alias": image.alias(),
        "in_force": in_force,
        "kept": keep.display().to_string(),
    });
    let mut text = format!(
        "{} words written and read back; what was there is in {}\n",
        written.words,
        keep.display()
    );
    text += &match in_force {
        true => format!("alias {} is in force (0012h)\n", written.alias),
        false => format!(
            "alias {} is in force when the device has been switched off and on; until then 0012h is {}\n",
            image.alias(),
            written.alias
        ),
    };
    tool.say(&json, text)?;
    Ok(true)
}

/// Keeps what the EEPROM holds. No file that is there is replaced: after an interrupted write it has the only valid image.
pub(crate) fn kept(tool: &Tool, before: &EepromContent, keep: &Path) -> Result<(), Failure> {
    if !keep.exists() {
        NewFile::write(keep, before.bytes())?;
        return Ok(());
    }
    let there = file_bytes(keep)?;
    if there == before.bytes() {
        return Ok(());
    }
    if before.image().is_err() && SiiImage::new(there).is_ok() {
        tool.note(format_args!("{} is kept as it is", keep.display()));
        return Ok(());
    }
    Err(format!(
        "{} is there already and holds something else: move it away, or name another file with --keep",
        keep.display()
    )
    .into())
}
