//! What the server logs.
//!
//! A subscriber may block: a paused terminal, a full pipe, a slow disk. The server's thread therefore calls none: it puts lines into a
//! bounded queue, and a thread of its own makes events of them. A line that finds the queue full is counted, and the number is logged in
//! its place. A line is no longer than [`LENGTH`], shows control characters by their number, and no more than [`ROOM`] are written in a second:
//! whoever asks without being allowed to fills no disk.

use std::{
    collections::VecDeque,
    fmt,
    panic::{AssertUnwindSafe, catch_unwind},
    sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant},
};

use tracing::{Dispatch, Level, dispatcher, level_filters::LevelFilter, subscriber::NoSubscriber};

const LOG: &str = "servocrab::attach";
/// Lines that wait for the thread that writes them, and that it writes in a second.
const ROOM: usize = 256;
/// Characters of a line.
const LENGTH: usize = 400;

/// Where lines are put.
#[derive(Debug, Clone, Default)]
pub(crate) struct Log(Arc<Queue>);

#[derive(Debug, Default)]
struct Queue {
    waiting: Mutex<Waiting>,
    changed: Condvar,
}

#[derive(Debug, Default)]
struct Waiting {
    lines: VecDeque<Line>,
    /// For how many lines there was no room. As long as it is not 0 nothing is queued, so that the number has its place.
    missed: u64,
    /// Nothing more is waited for.
    is_over: bool,
}

#[derive(Debug)]
enum Line {
    Text(Level, String),
    Missed(u64),
}

impl Log {
    pub fn debug(&self, text: fmt::Arguments<'_>) {
        self.put(Level::DEBUG, text);
    }

    pub fn info(&self, text: fmt::Arguments<'_>) {
        self.put(Level::INFO, text);
    }

    pub fn warn(&self, text: fmt::Arguments<'_>) {
        self.put(Level::WARN, text);
    }

    pub fn error(&self, text: fmt::Arguments<'_>) {
        self.put(Level::ERROR, text);
    }

    /// It waits for no subscriber, and does nothing where nobody listens to events of this level.
    fn put(&self, level: Level, text: fmt::Arguments<'_>) {
        if level > LevelFilter::current() {
            return;
        }
        self.0.push(Line::Text(level, shown(&text.to_string())));
    }

    /// Has [`write_all`](Self::write_all) end, once it has written what waits.
    pub fn close(&self) {
        self.0.waiting().is_over = true;
        self.0.changed.notify_all();
    }

    /// Makes events of all lines for this subscriber, until the log is closed.
    pub fn write_all(&self, subscriber: &Subscriber) {
        let mut pace = Pace::default();
        while let Some(line) = self.0.next() {
            if let Some(pause) = pace.pause(Instant::now()) {
                self.0.rest(pause);
            }
            // A subscriber that panics has cost the line that it was given, and no other one.
            let _ = catch_unwind(AssertUnwindSafe(|| subscriber.of(|| line.write())));
        }
    }
}

/// A line as it is logged.
fn shown(text: &str) -> String {
    let mut line = String::new();
    for char in text.chars().take(LENGTH) {
        if char.is_control() {
            line.extend(char.escape_unicode());
        } else {
            line.push(char);
        }
    }
    if text.chars().nth(LENGTH).is_some() {
        line.push('…');
    }
    line
}

/// How many lines were written in this second.
#[derive(Debug, Default)]
struct Pace {
    /// When it is over.
    until: Option<Instant>,
    lines: usize,
}

impl Pace {
    /// A line is written now: how long to wait before.
    fn pause(&mut self, now: Instant) -> Option<Duration> {
        let over = self.until.is_none_or(|until| until <= now);
        let pause = match self.until {
            Some(until) if !over && self.lines == ROOM => Some(until - now),
            _ => None,
        };
        if over || pause.is_some() {
            self.until = Some(now + pause.unwrap_or_default() + Duration::from_secs(1));
            self.lines = 0;
        }
        self.lines += 1;
        pause
    }
}

impl Queue {
    fn waiting(&self) -> MutexGuard<'_, Waiting> {
        self.waiting.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn push(&self, line: Line) {
        let mut waiting = self.waiting();
        if waiting.missed > 0 || waiting.lines.len() >= ROOM {
            waiting.missed = waiting.missed.saturating_add(1);
        } else {
            waiting.lines.push_back(line);
        }
        self.changed.notify_all();
    }

    /// Waits for so long, or for the end.
    fn rest(&self, time: Duration) {
        let goes_on = |waiting: &mut Waiting| !waiting.is_over;
        drop(
            self.changed
                .wait_timeout_while(self.waiting(), time, goes_on),
        );
    }

    /// Waits for the next line; `None` at the end.
    fn next(&self) -> Option<Line> {
        let is_idle = |waiting: &mut Waiting| {
            waiting.lines.is_empty() && waiting.missed == 0 && !waiting.is_over
        };
        let waited = self.changed.wait_while(self.waiting(), is_idle);
        let mut waiting = waited.unwrap_or_else(PoisonError::into_inner);
        let line = waiting.lines.pop_front();
        line.or_else(|| match std::mem::take(&mut waiting.missed) {
            0 => None,
            missed => Some(Line::Missed(missed)),
        })
    }
}

impl Line {
    fn write(self) {
        match self {
            Self::Text(Level::ERROR, text) => tracing::error!(target: LOG, "{text}"),
            Self::Text(Level::WARN, text) => tracing::warn!(target: LOG, "{text}"),
            Self::Text(Level::INFO, text) => tracing::info!(target: LOG, "{text}"),
            Self::Text(_, text) => tracing::debug!(target: LOG, "{text}"),
            Self::Missed(missed) => tracing::warn!(
                target: LOG,
                missed,
                "lines found no room while the log was behind: they are not logged"
            ),
        }
    }
}

/// To whom the events go.
#[derive(Clone)]
pub(crate) struct Subscriber(Dispatch);

impl Subscriber {
    /// The default of this thread.
    pub fn current() -> Self {
        Self(dispatcher::get_default(Clone::clone))
    }

    /// Does something with it as the default. A program that has none yet may set one for all threads later.
    fn of(&self, what: impl FnOnce()) {
        if self.0.is::<NoSubscriber>() {
            return what();
        }
        dispatcher::with_default(&self.0, what);
    }
}

/// Does something without a subscriber, as a thread does that none may hold up: what the library logs in its calls is not logged here.
pub(crate) fn unlogged(what: impl FnOnce()) {
    dispatcher::with_default(&Dispatch::none(), what);
}

#[cfg(test)]
mod tests {
    use std::fmt::{Debug, Write};

    use tracing::{
        Event, Metadata,
        field::{Field, Visit},
        span,
    };

    use super::*;

    /// Keeps the events; one of them it does not survive.
    #[derive(Clone, Default)]
    struct Seen(Arc<Mutex<Vec<String>>>);

    impl tracing::Subscriber for Seen {
        fn enabled(&self, _: &Metadata<'_>) -> bool {
            true
        }

        fn new_span(&self, _: &span::Attributes<'_>) -> span::Id {
            span::Id::from_u64(1)
        }

        fn record(&self, _: &span::Id, _: &span::Record<'_>) {}

        fn record_follows_from(&self, _: &span::Id, _: &span::Id) {}

        fn event(&self, event: &Event<'_>) {
            let mut text = EventText(event.metadata().level().to_string());
            event.record(&mut text);
            assert!(!text.0.contains("deadly"), "{}", text.0);
            self.0.lock().unwrap().push(text.0);
        }

        fn enter(&self, _: &span::Id) {}

        fn exit(&self, _: &span::Id) {}
    }

    struct EventText(String);

    impl Visit for EventText {
        fn record_debug(&mut self, field: &Field, value: &dyn Debug) {
            write!(self.0, " {}={value:?}", field.name()).unwrap();
        }
    }

    /// What a subscriber gets of this log, after what is done with it.
    fn seen(log: &Log, what: impl FnOnce()) -> Vec<String> {
        let seen = Seen::default();
        dispatcher::with_default(&Dispatch::new(seen.clone()), || {
            what();
            log.close();
            log.write_all(&Subscriber::current());
        });
        seen.0.lock().unwrap().clone()
    }

    #[test]
    fn each_line_is_an_event_of_its_level_and_a_subscriber_that_panics_costs_one() {
        let log = Log::default();
        let lines = seen(&log, || {
            log.error(format_args!("one"));
            log.warn(format_args!("deadly"));
            log.warn(format_args!("two"));
            log.info(format_args!("three"));
            log.debug(format_args!("four"));
        });
        let expected = [
            "ERROR message=one",
            "WARN message=two",
            "INFO message=three",
            "DEBUG message=four",
        ];
        assert_eq!(lines, expected);
    }

    #[test]
    fn a_line_is_short_and_moves_no_cursor() {
        let log = Log::default();
        let lines = seen(&log, || {
            log.warn(format_args!("refused /\u{1b}[2J\n{}", "x".repeat(8_000)));
        });
        let [line] = &lines[..] else {
            panic!("{lines:?}")
        };
        assert!(line.starts_with("WARN message=refused /\\u{1b}[2J\\u{a}xxx"));
        assert!(line.ends_with("x…") && line.len() < 450, "{}", line.len());
    }

    #[test]
    fn no_more_lines_are_written_in_a_second_than_there_is_room_for() {
        let mut pace = Pace::default();
        let begin = Instant::now();
        let at = |ms| begin + Duration::from_millis(ms);
        assert!((0..ROOM).all(|_| pace.pause(at(10)).is_none()));
        assert_eq!(pace.pause(at(300)), Some(Duration::from_millis(710)));
        assert!((1..ROOM).all(|_| pace.pause(at(1_010)).is_none()));
        assert!(pace.pause(at(1_010)).is_some());
        assert_eq!(pace.pause(at(9_000)), None);
    }

    #[test]
    fn lines_that_find_no_room_are_counted_and_their_number_is_logged_in_their_place() {
        let log = Log::default();
        let lines = seen(&log, || {
            (0..ROOM + 5).for_each(|number| log.info(format_args!("{number}")));
            // There is room again, but the number is not reported yet.
            assert!(log.0.next().is_some());
            log.info(format_args!("late"));
        });
        assert_eq!(lines.len(), ROOM, "{lines:#?}");
        let last = format!("INFO message={}", ROOM - 1);
        assert_eq!(lines.get(ROOM - 2), Some(&last));
        let missed = lines.last().unwrap();
        assert!(
            missed.starts_with("WARN ") && missed.contains("missed=6"),
            "{missed}"
        );
    }
}
