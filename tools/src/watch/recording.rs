//! The cycles as an MCAP file, which PlotJuggler, Foxglove and Lichtblick open: one channel, a JSON message for each cycle.

use std::{
    collections::BTreeMap,
    fs::File,
    io::{BufWriter, Write},
    path::{Path, PathBuf},
};

use mcap::{McapError, McapResult, WriteOptions, Writer, records::MessageHeader};
use serde_json::{Map, Value, json};
use servocrab::bus::RecordedValues;
use servocrab_attach::WatchedSignal;

use crate::output::Failure;

const TOPIC: &str = "/servocrab";
const SCHEMA: &str = "servocrab.Cycle";

/// An MCAP file that grows by the cycles.
pub(super) struct Recording {
    path: PathBuf,
    writer: Writer<BufWriter<File>>,
    channel: u16,
    signals: Vec<String>,
    messages: u32,
}

impl Recording {
    pub(super) fn create(path: &Path, signals: &[WatchedSignal]) -> Result<Self, Failure> {
        let file = File::create(path).map_err(|error| failed(path, &error.into()))?;
        let schema = schema(signals).to_string();
        let begun = || {
            let library = concat!("servocrab ", env!("CARGO_PKG_VERSION"));
            let options = WriteOptions::new().compression(None).library(library);
            let mut writer = options.create(BufWriter::new(file))?;
            let schema = writer.add_schema(SCHEMA, "jsonschema", schema.as_bytes())?;
            let channel = writer.add_channel(schema, TOPIC, "json", &BTreeMap::new())?;
            McapResult::Ok((writer, channel))
        };
        let (writer, channel) = begun().map_err(|error| failed(path, &error))?;
        Ok(Self {
            path: path.to_owned(),
            writer,
            channel,
            signals: signals.iter().map(|known| known.signal.clone()).collect(),
            messages: 0,
        })
    }

    pub(super) fn write(&mut self, cycle: &RecordedValues) -> Result<(), Failure> {
        let time = u64::try_from(cycle.time.as_nanos()).unwrap_or(u64::MAX);
        let header = MessageHeader {
            channel_id: self.channel,
            sequence: self.messages,
            log_time: time,
            publish_time: time,
        };
        let message = message(&self.signals, cycle).to_string();
        let written = self
            .writer
            .write_to_known_channel(&header, message.as_bytes());
        written.map_err(|error| failed(&self.path, &error))?;
        self.messages = self.messages.wrapping_add(1);
        Ok(())
    }

    /// Writes the index and the footer, without which a file is not whole.
    pub(super) fn complete(mut self) -> Result<(), Failure> {
        let finished = self.writer.finish();
        finished.map_err(|error| failed(&self.path, &error))?;
        let flushed = self.writer.into_inner().flush();
        flushed.map_err(|error| failed(&self.path, &error.into()))
    }
}

fn failed(path: &Path, error: &McapError) -> Failure {
    // Its own text leaves out what the system says.
    let reason = match error {
        McapError::Io(error) => error.to_string(),
        other => other.to_string(),
    };
    format!("{}: {reason}", path.display()).into()
}

/// The signals with their units. Each type is one word, since Foxglove and Lichtblick refuse a schema with a list of types.
fn schema(signals: &[WatchedSignal]) -> Value {
    let number = json!({"type": "integer", "description": "number of the cycle, from 1"});
    let mut properties = Map::from_iter([("cycle".to_owned(), number)]);
    for WatchedSignal { signal, unit } in signals {
        let property = json!({"type": "number", "description": unit});
        properties.insert(signal.clone(), property);
    }
    json!({
        "$schema": "http://json-schema.org/draft-07/schema#",
        "title": SCHEMA,
        "type": "object",
        "properties": properties,
        "required": ["cycle"],
    })
}

/// The values of a cycle. What the device did not send is left out.
fn message(signals: &[String], cycle: &RecordedValues) -> Value {
    let mut message = Map::from_iter([("cycle".to_owned(), json!(cycle.number))]);
    for (signal, value) in signals.iter().zip(&cycle.values) {
        if let Some(value) = value {
            message.insert(signal.clone(), json!(value));
        }
    }
    message.into()
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    #[test]
    fn a_value_that_was_not_sent_is_left_out_and_each_type_is_one_word() {
        let signal = |signal: &str, unit: &str| WatchedSignal {
            signal: signal.into(),
            unit: unit.into(),
        };
        let schema = schema(&[signal("x.position", "mm"), signal("x.state", "")]);
        let properties = schema["properties"].as_object().unwrap();
        assert!(properties.values().all(|known| known["type"].is_string()));
        assert_eq!(properties["x.position"]["description"], "mm");
        let cycle = RecordedValues {
            number: 7,
            time: Duration::ZERO,
            values: vec![None, Some(1.0)],
        };
        let message = message(&["x.position".into(), "x.state".into()], &cycle);
        assert_eq!(message, json!({"cycle": 7, "x.state": 1.0}));
    }
}
