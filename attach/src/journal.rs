//! What clients have commanded: the latest commands, by whom, and how each has ended.

use std::{
    collections::VecDeque,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant, SystemTime, UNIX_EPOCH},
};

use serde_json::{Value, json};

use crate::server::Client;

/// Commands that are kept.
const KEPT: usize = 64;
/// Characters of a text.
const LENGTH: usize = 300;
/// A stop that is asked for again within this time is the same one: a page asks twice, by two ways.
const SAME_STOP: Duration = Duration::from_secs(1);

#[derive(Debug, Clone, Default)]
pub(crate) struct Journal(Arc<Mutex<Kept>>);

#[derive(Debug, Default)]
struct Kept {
    next: u64,
    entries: VecDeque<Entry>,
}

#[derive(Debug)]
struct Entry {
    number: u64,
    /// For people, who have a clock.
    at: SystemTime,
    begun: Instant,
    client: String,
    what: String,
    times: u32,
    end: Option<End>,
}

#[derive(Debug)]
struct End {
    is_done: bool,
    text: String,
    after: Duration,
}

impl Journal {
    /// A command that takes its time: what is given ends it.
    pub fn begin(&self, client: &Client, what: &str) -> Begun {
        let mut kept = self.kept();
        let number = kept.push(client, what);
        Begun {
            journal: self.clone(),
            number,
            is_over: false,
        }
    }

    /// A stop, which is in the next frame.
    pub fn stop(&self, client: &Client, what: &str) {
        let mut kept = self.kept();
        let latest = kept.entries.back_mut();
        if let Some(same) =
            latest.filter(|entry| entry.what == what && entry.begun.elapsed() < SAME_STOP)
        {
            same.times = same.times.saturating_add(1);
            return;
        }
        let number = kept.push(client, what);
        kept.end(number, true, "sent in the next frame");
    }

    pub fn json(&self) -> Value {
        let kept = self.kept();
        kept.entries.iter().map(Entry::json).collect()
    }

    fn kept(&self) -> MutexGuard<'_, Kept> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Kept {
    fn push(&mut self, client: &Client, what: &str) -> u64 {
        let number = self.next;
        self.next += 1;
        if self.entries.len() >= KEPT {
            self.entries.pop_front();
        }
        self.entries.push_back(Entry {
            number,
            at: SystemTime::now(),
            begun: Instant::now(),
            client: client.to_string(),
            what: short(what),
            times: 1,
            end: None,
        });
        number
    }

    /// Nothing where it is no longer kept, or has ended.
    fn end(&mut self, number: u64, is_done: bool, text: &str) {
        let mut entries = self.entries.iter_mut();
        let entry = entries.find(|entry| entry.number == number && entry.end.is_none());
        if let Some(entry) = entry {
            entry.end = Some(End {
                is_done,
                text: short(text),
                after: entry.begun.elapsed(),
            });
        }
    }
}

impl Entry {
    fn json(&self) -> Value {
        let at = self.at.duration_since(UNIX_EPOCH).unwrap_or_default();
        json!({
            "number": self.number,
            "at": at.as_secs_f64(),
            "client": self.client,
            "what": self.what,
            "times": self.times,
            "done": self.end.as_ref().map(|end| end.is_done),
            "outcome": self.end.as_ref().map(|end| &end.text),
            "seconds": self.end.as_ref().map(|end| end.after.as_secs_f64()),
        })
    }
}

fn short(text: &str) -> String {
    match text.char_indices().nth(LENGTH) {
        Some((end, _)) => format!("{}…", &text[..end]),
        None => text.to_owned(),
    }
}

/// A command under way. Dropped without an outcome, it was given up.
#[derive(Debug)]
pub(crate) struct Begun {
    journal: Journal,
    number: u64,
    is_over: bool,
}

impl Begun {
    pub fn done(self, outcome: &str) {
        self.end(true, outcome);
    }

    pub fn failed(self, why: &str) {
        self.end(false, why);
    }

    fn end(mut self, is_done: bool, text: &str) {
        self.is_over = true;
        self.journal.kept().end(self.number, is_done, text);
    }
}

impl Drop for Begun {
    fn drop(&mut self) {
        if !self.is_over {
            self.journal.kept().end(self.number, false, "given up");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn client() -> Client {
        Client::Local {
            user: 7,
            process: None,
        }
    }

    #[test]
    fn the_latest_commands_are_kept_with_their_ends() {
        let journal = Journal::default();
        let early = journal.begin(&client(), "move x");
        let moved = journal.begin(&client(), "move y");
        drop(journal.begin(&client(), "home z"));
        moved.failed("it has a fault");
        let all = journal.json();
        let ends: Vec<_> = (0..3)
            .map(|at| (&all[at]["what"], &all[at]["done"]))
            .collect();
        assert_eq!(
            ends,
            [
                (&json!("move x"), &Value::Null),
                (&json!("move y"), &json!(false)),
                (&json!("home z"), &json!(false))
            ]
        );
        assert_eq!(all[1]["outcome"], "it has a fault");
        assert_eq!(all[2]["outcome"], "given up");
        assert_eq!(all[1]["client"], "user 7");
        for number in 0..KEPT {
            journal.begin(&client(), &number.to_string()).done("so");
        }
        // What is no longer kept may end all the same.
        early.done("at its target");
        let all = journal.json();
        let all = all.as_array().unwrap();
        assert_eq!((all.len(), &all[0]["number"]), (KEPT, &json!(3)));
        assert!(all.iter().all(|entry| entry["done"] == true));
    }

    #[test]
    fn a_stop_that_comes_by_two_ways_is_one() {
        let journal = Journal::default();
        journal.stop(&client(), "stop x");
        journal.stop(&client(), "stop x");
        journal.stop(&client(), "stop y");
        let all = journal.json();
        assert_eq!((&all[0]["times"], &all[1]["times"]), (&2.into(), &1.into()));
        assert_eq!(all.as_array().unwrap().len(), 2);
    }

    #[test]
    fn a_long_text_is_cut() {
        let journal = Journal::default();
        journal.begin(&client(), &"ä".repeat(9_000)).done("so");
        let what = journal.json()[0]["what"].as_str().unwrap().chars().count();
        assert_eq!(what, LENGTH + 1);
    }
}
