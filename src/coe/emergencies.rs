//! The emergencies of a drive or of a whole network, on their way to a program.

use alloc::borrow::Cow;
use alloc::sync::Arc;
use core::fmt;
use core::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use core::time::Duration;

use smol::channel::{Receiver, Sender, bounded};
use smol::stream::{Stream, StreamExt, unfold};

use super::emergency::Emergency;
use super::error::DriveId;
use super::error::ErrorTexts;
use crate::{sync::Recent, wakes::Waiters};

/// An emergency message, whose it is, when it was read, and what it means.
#[derive(Debug, Clone, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[non_exhaustive]
pub struct DriveEmergency {
    /// The drive that sent it.
    pub drive: Arc<DriveId>,
    /// When it was read from the drive's mailbox, on the bus's clock.
    pub at: Duration,
    /// What the drive said.
    pub emergency: Emergency,
    /// What it means, by the drive's own table ([`ErrorTexts`](super::ErrorTexts)) or by CiA 402.
    pub text: Cow<'static, str>,
}

impl fmt::Display for DriveEmergency {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Emergency {
            code,
            register,
            data,
        } = self.emergency;
        write!(
            f,
            "{}: emergency {code:04X}h ({}), error register {register:02X}h, data",
            self.drive, self.text
        )?;
        data.iter().try_for_each(|byte| write!(f, " {byte:02X}"))?;
        write!(f, ", read at {:.3} s", self.at.as_secs_f64())
    }
}

/// What comes out of [`Emergencies`].
#[derive(Debug, Clone, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[non_exhaustive]
pub enum EmergencyReport {
    /// An emergency.
    Emergency(DriveEmergency),
    /// Here so many emergencies found the queue full and were lost. The drives may still have them in 1003h.
    Overflow {
        /// How many.
        lost: u64,
    },
}

impl EmergencyReport {
    /// The emergency, if it is one.
    #[must_use]
    pub fn emergency(self) -> Option<DriveEmergency> {
        match self {
            Self::Emergency(emergency) => Some(emergency),
            Self::Overflow { .. } => None,
        }
    }
}

impl fmt::Display for EmergencyReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Emergency(emergency) => emergency.fmt(f),
            Self::Overflow { lost } => {
                write!(f, "{lost} emergencies found the queue full and were lost")
            }
        }
    }
}

/// Emergencies of one drive, or of all drives of a network, in the order in which they were read. Each is taken once: clones share
/// them.
///
/// The queue holds a bounded number that nobody has taken. When it is full the oldest stay, since they show the cause. Dropped ones
/// are counted, and the number is reported in their place ([`EmergencyReport::Overflow`]).
///
/// ```no_run
/// # async fn example(net: &servocrab::Network) {
/// use smol::stream::StreamExt;
/// let mut emergencies = net.all_emergencies().stream();
/// while let Some(report) = emergencies.next().await {
///     eprintln!("{report}");
/// }
/// # }
/// ```
#[derive(Debug, Clone)]
pub struct Emergencies {
    queue: Receiver<Queued>,
    waiters: Arc<Waiters>,
    overflow: Arc<Overflow>,
    counted: Arc<CodeCounts>,
    recent: Arc<Recent<Received>>,
}

impl Emergencies {
    /// The latest, the oldest first, each with its number from 0: up to 64, whether they were taken or not. None is taken by it.
    #[must_use]
    pub fn recent(&self) -> Vec<(u64, DriveEmergency)> {
        let read = self.recent.read().into_iter();
        read.map(|(number, received)| (number, received.into()))
            .collect()
    }

    /// How many there were of each code, whether they were taken or not. Sixteen codes are told apart; `None` stands for all others.
    /// That an error is gone (0000h) is no emergency.
    #[must_use]
    pub fn counted(&self) -> Vec<(Option<u16>, u64)> {
        self.counted.read()
    }

    /// The next report; `None` once the bus is gone and all have been taken.
    pub async fn next(&self) -> Option<EmergencyReport> {
        loop {
            let queued = self.waiters.relay(self.queue.recv()).await.ok()?;
            if let Some(report) = self.overflow.report(queued) {
                return Some(report);
            }
        }
    }

    /// The next report, if there is one now.
    #[must_use]
    pub fn try_next(&self) -> Option<EmergencyReport> {
        loop {
            let queued = self.queue.try_recv().ok()?;
            if let Some(report) = self.overflow.report(queued) {
                return Some(report);
            }
        }
    }

    /// The reports as a stream, which ends when the bus is gone.
    pub fn stream(self) -> impl Stream<Item = EmergencyReport> + Send + Unpin {
        unfold(self, async |emergencies| {
            let report = emergencies.next().await?;
            Some((report, emergencies))
        })
        .boxed()
    }
}

/// An emergency as it was read. Its meaning is made, on the heap where need be, on the program's side.
#[derive(Debug, Clone)]
pub(super) struct Received {
    pub drive: Arc<DriveId>,
    pub at: Duration,
    pub emergency: Emergency,
    pub texts: Arc<ErrorTexts>,
}

impl From<Received> for DriveEmergency {
    fn from(received: Received) -> Self {
        Self {
            text: received.texts.text(&received.emergency),
            drive: received.drive,
            at: received.at,
            emergency: received.emergency,
        }
    }
}

#[derive(Debug)]
enum Queued {
    Emergency(Received),
    /// The place of what was lost.
    Overflow,
}

/// How many were lost since that was last reported, and whether the queue holds a place from which it will be reported.
#[derive(Debug, Default)]
struct Overflow {
    lost: AtomicU64,
    queued: AtomicBool,
}

impl Overflow {
    /// The report as a program gets it: the place of what was lost gets the number. None if it has been reported before.
    fn report(&self, queued: Queued) -> Option<EmergencyReport> {
        if let Queued::Emergency(received) = queued {
            return Some(EmergencyReport::Emergency(received.into()));
        }
        // In this order: a thread that adds from now on queues a place of its own, or is in the number below.
        self.queued.store(false, Ordering::SeqCst);
        let lost = self.lost.swap(0, Ordering::SeqCst);
        (lost != 0).then_some(EmergencyReport::Overflow { lost })
    }
}

/// How many emergencies there were of each code. One thread counts, and any may read.
#[derive(Debug, Default)]
pub(crate) struct CodeCounts {
    /// The code above the number; 0 in a place that is free.
    codes: [AtomicU64; 16],
    others: AtomicU64,
}

const NUMBER: u64 = (1 << 48) - 1;

impl CodeCounts {
    /// Only one thread may do this. `None` is counted with those that find no place.
    pub fn add(&self, code: Option<u16>) {
        let Some(code) = code else {
            self.others.fetch_add(1, Ordering::Relaxed);
            return;
        };
        for place in &self.codes {
            let held = place.load(Ordering::Relaxed);
            if held == 0 || held >> 48 == u64::from(code) {
                let number = (held & NUMBER) + 1;
                place.store(u64::from(code) << 48 | number, Ordering::Relaxed);
                return;
            }
        }
        self.others.fetch_add(1, Ordering::Relaxed);
    }

    pub fn read(&self) -> Vec<(Option<u16>, u64)> {
        let codes = self.codes.iter().map(|place| {
            let held = place.load(Ordering::Relaxed);
            (Some((held >> 48) as u16), held & NUMBER)
        });
        let others = (None, self.others.load(Ordering::Relaxed));
        let all = codes.chain([others]);
        all.filter(|(_, number)| *number > 0).collect()
    }
}

/// The bus's end of [`Emergencies`]: used on one thread.
#[derive(Debug, Clone)]
pub(crate) struct EmergencyQueue {
    queue: Sender<Queued>,
    capacity: usize,
    overflow: Arc<Overflow>,
    counted: Arc<CodeCounts>,
    recent: Arc<Recent<Received>>,
}

impl EmergencyQueue {
    /// A queue of this many emergencies, and where those wait who want them.
    pub fn new(capacity: usize, waiters: Arc<Waiters>) -> (Self, Emergencies) {
        let capacity = capacity.max(1);
        // One more, for the place of what was lost.
        let (sender, receiver) = bounded(capacity.saturating_add(1));
        let overflow = Arc::new(Overflow::default());
        let counted = Arc::new(CodeCounts::default());
        let recent = Arc::new(Recent::default());
        let queue = Self {
            queue: sender,
            capacity,
            overflow: Arc::clone(&overflow),
            counted: Arc::clone(&counted),
            recent: Arc::clone(&recent),
        };
        let emergencies = Emergencies {
            queue: receiver,
            waiters,
            overflow,
            counted,
            recent,
        };
        (queue, emergencies)
    }

    pub(super) fn push(&self, emergency: Received) {
        // 0000h says that an error is gone.
        if emergency.emergency.code != 0 {
            self.counted.add(Some(emergency.emergency.code));
        }
        self.recent.keep(emergency.clone());
        if self.queue.len() < self.capacity {
            // It fails only where nobody can ask any more.
            let _ = self.queue.try_send(Queued::Emergency(emergency));
            return;
        }
        self.overflow.lost.fetch_add(1, Ordering::SeqCst);
        if !self.overflow.queued.swap(true, Ordering::SeqCst) {
            let _ = self.queue.try_send(Queued::Overflow);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sii::Identity;

    fn emergency(code: u16) -> Received {
        Received {
            drive: Arc::new(DriveId {
                position: 3,
                name: "x".into(),
                identity: Identity::default(),
            }),
            at: Duration::from_millis(1_500),
            emergency: Emergency {
                code,
                register: 0x21,
                data: [0, 1, 2, 3, 4],
            },
            texts: Arc::default(),
        }
    }

    /// Codes, and numbers of lost ones below zero.
    fn taken(emergencies: &Emergencies) -> Vec<i64> {
        core::iter::from_fn(|| emergencies.try_next())
            .map(|report| match report {
                EmergencyReport::Emergency(emergency) => i64::from(emergency.emergency.code),
                EmergencyReport::Overflow { lost } => -i64::try_from(lost).unwrap(),
            })
            .collect()
    }

    #[test]
    fn what_is_lost_is_told_once_in_its_place() {
        let (queue, emergencies) = EmergencyQueue::new(3, Waiters::direct());
        (1..=5).for_each(|code| queue.push(emergency(code)));
        assert_eq!(taken(&emergencies), [1, 2, 3, -2]);
        assert!(taken(&emergencies).is_empty());
        (6..=8).for_each(|code| queue.push(emergency(code)));
        assert_eq!(taken(&emergencies), [6, 7, 8], "as much room as before");
    }

    #[test]
    fn each_code_is_counted_whether_taken_or_lost_and_all_beyond_sixteen_together() {
        let (queue, emergencies) = EmergencyQueue::new(1, Waiters::direct());
        for code in [0x8611, 0, 0xFFFF, 0x8611] {
            queue.push(emergency(code));
        }
        assert_eq!(
            emergencies.counted(),
            [(Some(0x8611), 2), (Some(0xFFFF), 1)]
        );
        (1..=17).for_each(|code| queue.push(emergency(code)));
        let counted = emergencies.counted();
        assert_eq!(counted.len(), 17);
        assert_eq!(counted.last(), Some(&(None, 3)));
    }

    #[test]
    fn what_comes_after_a_loss_is_behind_it() {
        let (queue, emergencies) = EmergencyQueue::new(3, Waiters::direct());
        (1..=5).for_each(|code| queue.push(emergency(code)));
        assert!(emergencies.try_next().is_some());
        assert!(emergencies.try_next().is_some());
        (6..=8).for_each(|code| queue.push(emergency(code)));
        assert_eq!(
            taken(&emergencies),
            [3, -4, 6],
            "7 and 8 found no room either"
        );
    }

    #[test]
    fn none_is_missing_from_the_numbers_while_another_thread_takes_them() {
        const SENT: u64 = 20_000;
        let (queue, emergencies) = EmergencyQueue::new(2, Waiters::direct());
        let reader = std::thread::spawn(move || {
            smol::block_on(async {
                let mut seen = 0;
                while let Some(report) = emergencies.next().await {
                    seen += match report {
                        EmergencyReport::Emergency(_) => 1,
                        EmergencyReport::Overflow { lost } => lost,
                    };
                }
                seen
            })
        });
        (0..SENT).for_each(|_| queue.push(emergency(1)));
        drop(queue);
        assert_eq!(reader.join().unwrap(), SENT);
    }

    #[test]
    fn an_emergency_says_whose_it_is_what_it_means_and_when_it_was_read() {
        let text = DriveEmergency::from(emergency(0x8611)).to_string();
        assert!(text.starts_with("drive 3 \"x\""), "{text}");
        assert!(
            text.ends_with(
                ": emergency 8611h (following error), error register 21h, data 00 01 02 03 04, read at 1.500 s"
            ),
            "{text}"
        );
    }
}
