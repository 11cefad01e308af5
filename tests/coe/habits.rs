//! Transfers with drives of bad habits: one that answers a message late, and one that sends emergencies around every reply.

use std::time::Duration;

use servocrab::coe::information::ListKind;
use servocrab::coe::{AbortCode, Clock, DriveError, SdoError, SdoHandle};
use servocrab_sim::Habits;
use servocrab_sim::personality::Servo;

use crate::datagrams::Wire;
use crate::{Ticks, with_device};

const MS: Duration = Duration::from_millis(1);

/// A transfer of each kind. Those of one object come in pairs, so that the late reply of the one could pass for the other's.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Kind {
    ReadShort,
    WriteShort,
    ReadLong,
    WriteLong,
    ReadAll,
    WriteAll,
    ReadOther,
    Describe,
    DescribeOther,
    List,
}

const KINDS: [Kind; 10] = [
    Kind::ReadShort,
    Kind::WriteShort,
    Kind::ReadLong,
    Kind::WriteLong,
    Kind::ReadAll,
    Kind::WriteAll,
    Kind::ReadOther,
    Kind::Describe,
    Kind::DescribeOther,
    Kind::List,
];

/// What is written, in three states of the drive's objects.
fn short(state: u8) -> Vec<u8> {
    vec![state, 0, 1, 0]
}

/// In four messages.
fn long(state: u8) -> Vec<u8> {
    vec![b'a' + state; 60]
}

fn limits(state: u8) -> Vec<u8> {
    let values = [-1_000 - i32::from(state), 1_000 + i32::from(state)];
    values
        .iter()
        .flat_map(|limit| limit.to_le_bytes())
        .collect()
}

impl Kind {
    fn writes(self) -> bool {
        matches!(self, Self::WriteShort | Self::WriteLong | Self::WriteAll)
    }

    /// What it reads, or writes.
    fn value(self, state: u8) -> Vec<u8> {
        match self {
            Self::ReadShort | Self::WriteShort => short(state),
            Self::ReadLong | Self::WriteLong => long(state),
            Self::ReadAll | Self::WriteAll => limits(state),
            Self::ReadOther => vec![0x92, 0x01, 0x02, 0x00],
            Self::Describe => b"Profile velocity".to_vec(),
            Self::DescribeOther => b"Software position limit".to_vec(),
            Self::List => vec![0x07, 0x60, 0x40, 0x60],
        }
    }

    /// The transfer that reads what this one writes.
    fn read_back(self) -> Self {
        match self {
            Self::WriteShort => Self::ReadShort,
            Self::WriteLong => Self::ReadLong,
            Self::WriteAll => Self::ReadAll,
            other => other,
        }
    }

    /// Writes of other values than a drive takes, and the reasons that it gives.
    fn wrong_value(self) -> Option<(Vec<u8>, AbortCode)> {
        match self {
            Self::WriteShort => Some((vec![1, 2], AbortCode(0x0607_0013))),
            Self::WriteLong => Some((vec![0; 4097], AbortCode(0x0607_0012))),
            Self::WriteAll => Some((vec![0; 12], AbortCode(0x0607_0012))),
            _ => None,
        }
    }

    async fn run(self, sdo: &SdoHandle, value: Vec<u8>) -> Result<Vec<u8>, DriveError> {
        match self {
            Self::ReadShort => sdo.read_bytes(0x6081, 0).await,
            Self::WriteShort => sdo
                .write_bytes(0x6081, 0, value.clone())
                .await
                .map(|()| value),
            Self::ReadLong => sdo.read_bytes(0x5F00, 0).await,
            Self::WriteLong => sdo
                .write_bytes(0x5F00, 0, value.clone())
                .await
                .map(|()| value),
            Self::ReadAll => sdo.read_complete(0x607D, 1).await,
            Self::WriteAll => sdo
                .write_complete(0x607D, 1, value.clone())
                .await
                .map(|()| value),
            Self::ReadOther => sdo.read_bytes(0x1000, 0).await,
            Self::Describe => Ok(sdo.describe_object(0x6081).await?.name.into_bytes()),
            Self::DescribeOther => Ok(sdo.describe_object(0x607D).await?.name.into_bytes()),
            Self::List => {
                let list = sdo.object_list(ListKind::Outputs).await?;
                Ok(list[..2]
                    .iter()
                    .flat_map(|index| index.to_le_bytes())
                    .collect())
            }
        }
    }
}

/// The objects as in state 0.
async fn prepare(sdo: &SdoHandle) {
    for kind in KINDS.into_iter().filter(|kind| kind.writes()) {
        kind.run(sdo, kind.value(0)).await.unwrap();
    }
}

fn set(wire: &Wire, habits: Habits) {
    wire.segment().device_mut(0).unwrap().set_habits(habits);
}

/// With mailboxes of 32 bytes, in a drive whose objects are in state 0.
fn with_objects<R>(work: impl AsyncFnOnce(Wire, SdoHandle) -> R) -> R {
    let device = Servo::generic().mailbox_bytes(32).build();
    with_device(device, async |wire, sdo, _| {
        prepare(&sdo).await;
        work(wire, sdo).await
    })
}

/// How many messages a drive takes for a transfer of each kind.
fn messages(kind: Kind) -> u64 {
    with_objects(async |wire, sdo| {
        let taken = || wire.segment().device(0).unwrap().messages_taken();
        let before = taken();
        kind.run(&sdo, kind.value(1)).await.unwrap();
        taken() - before
    })
}

/// A transfer of which the drive answers one message after it was given up.
async fn given_up(wire: &Wire, sdo: &SdoHandle, kind: Kind, late: u64) {
    let habits = Habits {
        late: Some((late, 50 * MS)),
        ..Habits::default()
    };
    set(wire, habits);
    let impatient = sdo.clone().with_timeout(20 * MS);
    let error = kind.run(&impatient, kind.value(1)).await.unwrap_err().error;
    assert!(
        matches!(error, SdoError::Timeout { .. }),
        "{kind:?}, message {late}: {error}"
    );
}

#[test]
fn no_late_answer_is_taken_for_that_of_the_next_transfer_whichever_both_are() {
    let (mut pairs, mut refused) = (0, 0);
    for first in KINDS {
        for late in 0..messages(first) {
            for second in KINDS {
                with_objects(async |wire, sdo| {
                    let what = format!("{second:?} behind message {late} of {first:?}");
                    given_up(&wire, &sdo, first, late).await;
                    let got = second.run(&sdo, second.value(2)).await;
                    let got = got.unwrap_or_else(|error| panic!("{what}: {error}"));
                    if second.writes() {
                        let read = second.read_back().run(&sdo, Vec::new()).await.unwrap();
                        assert_eq!(read, second.value(2), "{what}");
                    } else {
                        // What was given up may have been written.
                        let as_written = [0, 1].map(|state| second.value(state));
                        assert!(as_written.contains(&got), "{what}: {got:02X?}");
                    }
                    // Nothing of it is left for later ones.
                    for third in KINDS.into_iter().filter(|kind| !kind.writes()) {
                        let got = third.run(&sdo, Vec::new()).await.unwrap();
                        let states = [0, 1, 2].map(|state| third.value(state));
                        assert!(states.contains(&got), "{third:?} after {what}: {got:02X?}");
                    }
                });
                pairs += 1;
                let Some((value, code)) = second.wrong_value() else {
                    continue;
                };
                with_objects(async |wire, sdo| {
                    given_up(&wire, &sdo, first, late).await;
                    let got = second.run(&sdo, value).await.map_err(|error| error.error);
                    let got = got.expect_err("a write that the drive refuses is not confirmed");
                    let what = format!("{second:?} behind message {late} of {first:?}: {got}");
                    assert_eq!(got.abort_code(), Some(code), "{what}");
                });
                refused += 1;
            }
        }
    }
    assert!(
        pairs >= 140 && refused >= 42,
        "{pairs} pairs, {refused} refused"
    );
}

#[test]
fn emergencies_around_every_reply_harm_no_transfer_and_are_delivered_in_order() {
    for mailbox in [32, 256] {
        let device = Servo::generic().mailbox_bytes(mailbox).build();
        with_device(device, async |wire, sdo, emergencies| {
            prepare(&sdo).await;
            let habits = Habits {
                emergencies: true,
                ..Habits::default()
            };
            set(&wire, habits);
            let mut expected = 0;
            let mut drain = async |what: &str| {
                // The last one comes behind the reply: it is collected while nothing is asked.
                let sent = wire.segment().device(0).unwrap().habitual_emergencies();
                while expected < sent {
                    let end = wire.now() + 100 * MS;
                    let missing = async {
                        Ticks(wire.clone()).sleep_until(end).await;
                        None
                    };
                    let next = smol::future::or(emergencies.next(), missing).await;
                    let next = next.unwrap_or_else(|| panic!("emergency {expected}: {what}"));
                    let next = next
                        .emergency()
                        .unwrap_or_else(|| panic!("some were lost: {what}"));
                    let next = next.emergency;
                    let [zero, a, b, c, d] = next.data;
                    assert_eq!((next.code, next.register, zero), (0xFF00, 0x81, 0));
                    assert_eq!(u32::from_le_bytes([a, b, c, d]), expected, "{what}");
                    expected += 1;
                }
                assert_eq!(emergencies.try_next(), None, "{what}");
            };
            for kind in KINDS {
                let got = kind.run(&sdo, kind.value(1)).await;
                let got = got.unwrap_or_else(|error| panic!("{kind:?}: {error}"));
                let states = [0, 1].map(|state| kind.value(state));
                assert!(states.contains(&got), "{kind:?}: {got:02X?}");
                drain(&format!("{kind:?}")).await;
                if let Some((value, code)) = kind.wrong_value() {
                    let error = kind.run(&sdo, value).await.unwrap_err().error;
                    assert_eq!(error.abort_code(), Some(code), "{kind:?}");
                    drain(&format!("{kind:?}, refused")).await;
                }
            }
            let (first, segment) = (usize::from(mailbox) - 16, usize::from(mailbox) - 9);
            for size in [
                1,
                4,
                5,
                first,
                first + 1,
                first + 7,
                first + segment,
                first + 12 * segment + 1,
            ] {
                let text: Vec<u8> = (0..size).map(|at| at as u8 | 1).collect();
                sdo.write_bytes(0x5F00, 0, text.clone()).await.unwrap();
                drain(&format!("writing {size} bytes")).await;
                assert_eq!(sdo.read_bytes(0x5F00, 0).await.unwrap(), text);
                drain(&format!("reading {size} bytes")).await;
            }
            assert!(expected > 100, "{expected} emergencies");
        });
    }
}
