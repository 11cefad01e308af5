//! The other end of a stream: the signals of a network that another program shows.

use std::{os::unix::net::UnixStream, path::Path, time::Duration};

use serde::Deserialize;
use servocrab::bus::{RecordedCycles, RecordedValues, Signal};
use tungstenite::{
    Message, WebSocket,
    client::{IntoClientRequest, client_with_config},
};

use crate::program::ClientError;

/// The values of every nth cycle of a network that another program shows on its Unix socket.
///
/// ```no_run
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// use servocrab_attach::{Watch, socket_of};
/// let signals = ["x.position".parse()?, "x.state".parse()?];
/// let mut watch = Watch::open(&socket_of("eth0"), &signals, 1)?;
/// while let Some(read) = watch.read()? {
///     for cycle in &read.cycles {
///         println!("{}: {:?}", cycle.number, cycle.values);
///     }
/// }
/// # Ok(())
/// # }
/// ```
#[derive(Debug)]
pub struct Watch {
    socket: WebSocket<UnixStream>,
    signals: Vec<WatchedSignal>,
    every: u64,
    last: Option<u64>,
}

/// A signal of a [`Watch`].
#[derive(Debug, Clone, PartialEq, Eq, Deserialize)]
pub struct WatchedSignal {
    /// Its name, as [`Signal`] is written.
    pub signal: String,
    /// Its unit, such as `mm/s`; empty where there is none.
    pub unit: String,
}

#[derive(Deserialize)]
struct Heading {
    signals: Vec<WatchedSignal>,
}

impl Watch {
    /// Begins to watch these signals, of every nth cycle. It waits for the program.
    ///
    /// # Errors
    /// [`ClientError`] where nobody is there, or the program does not have one of the signals.
    pub fn open(socket: &Path, signals: &[Signal], every: u32) -> Result<Self, ClientError> {
        let stream = UnixStream::connect(socket).map_err(ClientError::Nobody)?;
        let names: String = signals
            .iter()
            .map(|signal| escaped(&signal.to_string()) + ",")
            .collect();
        let names = names.trim_end_matches(',');
        let request = format!("ws://localhost/v1/stream?every={every}&signals={names}");
        let request = request
            .into_client_request()
            .map_err(|error| ClientError::protocol(&error))?;
        let (mut socket, _) =
            client_with_config(request, stream, None).map_err(|error| match error {
                tungstenite::HandshakeError::Failure(tungstenite::Error::Http(response)) => {
                    let body = response.body().as_deref().unwrap_or_default();
                    ClientError::refused(body)
                }
                other => ClientError::protocol(&other),
            })?;
        let heading = match socket
            .read()
            .map_err(|error| ClientError::protocol(&error))?
        {
            Message::Text(text) => {
                serde_json::from_str(&text).map_err(|error| ClientError::protocol(&error))
            }
            other => Err(ClientError::protocol(&format!("{other:?}"))),
        };
        let Heading { signals } = heading?;
        Ok(Self {
            socket,
            signals,
            every: u64::from(every.max(1)),
            last: None,
        })
    }

    /// The signals, in the order of their values.
    #[must_use]
    pub fn signals(&self) -> &[WatchedSignal] {
        &self.signals
    }

    /// The next cycles, which it waits for; `None` once the program has ended its network. What was lost on the way is counted.
    ///
    /// # Errors
    /// [`ClientError::Protocol`] for what is no block of a stream.
    pub fn read(&mut self) -> Result<Option<RecordedCycles>, ClientError> {
        loop {
            match self.socket.read() {
                Ok(Message::Binary(block)) => {
                    let cycles = decode(&block, self.signals.len())
                        .ok_or_else(|| ClientError::protocol("a block of another length"))?;
                    return Ok(Some(self.counted(cycles)));
                }
                Ok(Message::Close(_))
                | Err(
                    tungstenite::Error::ConnectionClosed
                    | tungstenite::Error::AlreadyClosed
                    | tungstenite::Error::Io(_)
                    | tungstenite::Error::Protocol(
                        tungstenite::error::ProtocolError::ResetWithoutClosingHandshake,
                    ),
                ) => return Ok(None),
                // How many blocks were left out shows in the numbers of the cycles.
                Ok(_) => {}
                Err(error) => return Err(ClientError::protocol(&error)),
            }
        }
    }

    /// With how many cycles are missing before and between them.
    fn counted(&mut self, cycles: Vec<RecordedValues>) -> RecordedCycles {
        let mut lost = 0;
        for cycle in &cycles {
            if let Some(last) = self.last {
                let steps = cycle.number.saturating_sub(last) / self.every;
                lost += steps.saturating_sub(1);
            }
            self.last = Some(cycle.number);
        }
        RecordedCycles { cycles, lost }
    }
}

/// As it may stand in a query.
fn escaped(name: &str) -> String {
    let bytes = name.bytes().map(|byte| match byte {
        b'A'..=b'Z' | b'a'..=b'z' | b'0'..=b'9' | b'-' | b'_' | b'.' => {
            char::from(byte).to_string()
        }
        _ => format!("%{byte:02X}"),
    });
    bytes.collect()
}

/// The cycles of a block, as `streams` writes it.
pub(crate) fn decode(block: &[u8], signals: usize) -> Option<Vec<RecordedValues>> {
    let (heading, mut rest) = block.split_at_checked(16)?;
    let count = u32::from_le_bytes(*heading.get(8..)?.first_chunk()?);
    let declared = u32::from_le_bytes(*heading.get(12..)?.first_chunk()?);
    if usize::try_from(declared) != Ok(signals) {
        return None;
    }
    let mut word = || {
        let (word, left) = rest.split_first_chunk()?;
        rest = left;
        Some(u64::from_le_bytes(*word))
    };
    let mut cycles = Vec::new();
    for _ in 0..count {
        let (number, time) = (word()?, Duration::from_nanos(word()?));
        let mut values = Vec::with_capacity(signals);
        for _ in 0..signals {
            let value = f64::from_bits(word()?);
            values.push((!value.is_nan()).then_some(value));
        }
        cycles.push(RecordedValues {
            number,
            time,
            values,
        });
    }
    rest.is_empty().then_some(cycles)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_block_that_is_cut_or_of_other_signals_is_none() {
        let mut block = vec![0; 8];
        block.extend(1_u32.to_le_bytes());
        block.extend(2_u32.to_le_bytes());
        for word in [7, 3000, 1.5_f64.to_bits(), f64::NAN.to_bits()] {
            block.extend(word.to_le_bytes());
        }
        let expected = RecordedValues {
            number: 7,
            time: Duration::from_micros(3),
            values: vec![Some(1.5), None],
        };
        assert_eq!(decode(&block, 2), Some(vec![expected]));
        assert_eq!(decode(&block, 1), None);
        for length in 0..block.len() {
            assert_eq!(decode(&block[..length], 2), None, "{length}");
        }
        block.push(0);
        assert_eq!(decode(&block, 2), None);
    }
}
