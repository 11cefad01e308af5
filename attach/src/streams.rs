//! Every cycle's values, to who asks for them over a WebSocket: read and encoded once for all who ask for the same.
//!
//! A stream begins with a text: its signals with their units. Blocks follow, in little-endian order: how many cycles were lost before it
//! (u64), how many it has (u32), how many signals each has (u32); then of each cycle its number (u64), its time in nanoseconds (u64),
//! and its values (f64 each, NaN where the device sent none).

use std::{
    collections::HashMap,
    sync::{Arc, Mutex, PoisonError},
    time::Duration,
};

use axum::{
    body::Bytes,
    extract::ws::{Message, WebSocket},
};
use serde_json::json;
use servocrab::{
    NetworkError,
    bus::{NetworkView, RecordedCycles, Recorder, Signal},
};
use tokio::{
    sync::broadcast::{self, error::RecvError},
    time::{MissedTickBehavior, interval, timeout},
};

/// From one block to the next.
const BLOCK: Duration = Duration::from_millis(40);
/// Blocks that wait for a client that reads slowly.
const WAITING: usize = 64;
/// A client that takes nothing for so long is not served any more.
pub(crate) const TAKES: Duration = Duration::from_secs(5);
/// Messages of a client between two blocks: it has nothing to say but that it is there.
const HEARD: u32 = 64;
/// Signals of one stream.
pub(crate) const SIGNALS: usize = 512;

type Key = (Vec<Signal>, u32);

/// The streams that somebody reads.
#[derive(Debug, Default)]
pub(crate) struct Streams {
    running: Mutex<HashMap<Key, broadcast::Sender<Bytes>>>,
}

/// What a client has asked for.
pub(crate) struct Stream {
    heading: String,
    blocks: broadcast::Receiver<Bytes>,
}

impl Streams {
    /// The stream of these signals, of every nth cycle. One that runs is shared.
    pub fn open(
        self: &Arc<Self>,
        view: &NetworkView,
        signals: &[Signal],
        every: u32,
    ) -> Result<Stream, NetworkError> {
        let recorder = view.recorder(signals.iter().cloned())?;
        let shown = recorder.signals().iter();
        let shown: Vec<_> = shown
            .map(|shown| json!({"signal": shown.signal.to_string(), "unit": shown.unit}))
            .collect();
        let heading = json!({"signals": shown, "every": every}).to_string();
        let key = (signals.to_vec(), every);
        let mut running = self.running.lock().unwrap_or_else(PoisonError::into_inner);
        let blocks = match running.get(&key) {
            Some(sender) => sender.subscribe(),
            None => {
                let (sender, blocks) = broadcast::channel(WAITING);
                running.insert(key.clone(), sender.clone());
                tokio::spawn(pump(Arc::clone(self), key, recorder, sender));
                blocks
            }
        };
        Ok(Stream { heading, blocks })
    }
}

/// Reads, encodes and sends, until nobody reads any more or the network has ended.
async fn pump(
    streams: Arc<Streams>,
    key: Key,
    mut recorder: Recorder,
    sender: broadcast::Sender<Bytes>,
) {
    let mut turns = interval(BLOCK);
    turns.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let mut lost = 0;
    loop {
        turns.tick().await;
        let read = recorder.read();
        // Under the lock: nobody subscribes to a stream that ends.
        let mut running = streams
            .running
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        if read.is_none() || sender.receiver_count() == 0 {
            running.remove(&key);
            return;
        }
        drop(running);
        if let Some(mut read) = read {
            read.cycles
                .retain(|cycle| cycle.number % u64::from(key.1) == 0);
            lost += read.lost;
            if read.cycles.is_empty() {
                continue;
            }
            read.lost = std::mem::take(&mut lost);
            // An error: the last reader has just gone.
            let _ = sender.send(encode(&read, key.0.len()));
        }
    }
}

fn encode(read: &RecordedCycles, signals: usize) -> Bytes {
    let mut bytes = Vec::with_capacity(16 + read.cycles.len() * (16 + 8 * signals));
    bytes.extend(read.lost.to_le_bytes());
    bytes.extend((read.cycles.len() as u32).to_le_bytes());
    bytes.extend((signals as u32).to_le_bytes());
    for cycle in &read.cycles {
        bytes.extend(cycle.number.to_le_bytes());
        let nanoseconds = u64::try_from(cycle.time.as_nanos()).unwrap_or(u64::MAX);
        bytes.extend(nanoseconds.to_le_bytes());
        for value in &cycle.values {
            bytes.extend(value.unwrap_or(f64::NAN).to_le_bytes());
        }
    }
    bytes.into()
}

impl Stream {
    /// Sends the stream until the client is gone, takes nothing any more, or the network has ended.
    pub async fn send(mut self, mut socket: WebSocket) {
        let heading = Message::Text(self.heading.into());
        if !sent(&mut socket, heading).await {
            return;
        }
        // Blocks that this client was too slow for.
        let mut left_out = 0;
        let mut heard = 0;
        loop {
            tokio::select! {
                block = self.blocks.recv() => match block {
                    Ok(bytes) => {
                        heard = 0;
                        if left_out > 0 {
                            let text = json!({"left_out_blocks": left_out}).to_string();
                            left_out = 0;
                            if !sent(&mut socket, Message::Text(text.into())).await {
                                return;
                            }
                        }
                        if !sent(&mut socket, Message::Binary(bytes)).await {
                            return;
                        }
                    }
                    Err(RecvError::Lagged(blocks)) => left_out += blocks,
                    Err(RecvError::Closed) => {
                        let _ = sent(&mut socket, Message::Close(None)).await;
                        return;
                    }
                },
                // It has nothing to say; that it goes is heard here.
                message = socket.recv() => match message {
                    Some(Ok(Message::Ping(_) | Message::Pong(_))) if heard < HEARD => heard += 1,
                    _ => return,
                },
            }
        }
    }
}

/// Whether the client has taken this in time.
pub(crate) async fn sent(socket: &mut WebSocket, message: Message) -> bool {
    matches!(timeout(TAKES, socket.send(message)).await, Ok(Ok(())))
}

#[cfg(test)]
mod tests {
    use servocrab::bus::RecordedValues;

    use super::*;

    #[test]
    fn a_block_has_the_bytes_that_its_page_says() {
        let read = RecordedCycles {
            cycles: vec![RecordedValues {
                number: 7,
                time: Duration::from_micros(3),
                values: vec![Some(1.5), None],
            }],
            lost: 2,
        };
        let bytes = encode(&read, 2);
        let word = |at: usize| u64::from_le_bytes(bytes[at..at + 8].try_into().unwrap());
        assert_eq!(bytes.len(), 16 + 16 + 16);
        assert_eq!((word(0), word(8)), (2, 1 | 2 << 32));
        assert_eq!((word(16), word(24)), (7, 3000));
        assert_eq!(f64::from_bits(word(32)), 1.5);
        assert!(f64::from_bits(word(40)).is_nan());
    }
}
