//! The session of `tests/vectors/sdo_session.txt`, byte for byte and on both sides alone: the client against those replies, the
//! simulated drive against those requests. `tests/interop` records that SOEM and the drive exchange the same messages.

use std::cell::RefCell;
use std::collections::VecDeque;
use std::rc::Rc;

use servocrab::coe::information::ListKind;
use servocrab::coe::{
    AbortCode, DriveError, DriveId, LinkFault, MailboxClient, MailboxSettings, MailboxStatus,
    MailboxTransport, SdoError, SdoHandle,
};
use servocrab::sii::{Identity, Mailbox, Protocols, Sii};
use servocrab_sim::personality::{self, Servo};

use crate::datagrams::{APWR, Wire};

/// Of the session.
const MAILBOX: u16 = 32;

/// One request and the messages that answer it.
struct Exchange {
    operation: &'static str,
    value: Vec<u8>,
    request: Vec<u8>,
    replies: Vec<Vec<u8>>,
    /// What SOEM sends in place of it; empty where it has no such call.
    by_soem: Vec<u8>,
}

fn bytes(text: &str) -> Vec<u8> {
    text.split_whitespace()
        .map(|byte| u8::from_str_radix(byte, 16).expect("a hexadecimal byte"))
        .collect()
}

fn session() -> Vec<Exchange> {
    let mut session: Vec<Exchange> = Vec::new();
    let table = include_str!("../vectors/sdo_session.txt");
    for line in table.lines().filter(|line| !line.starts_with('#')) {
        let columns: Vec<_> = line.split('|').map(str::trim).collect();
        let reply = bytes(columns[3]);
        if columns[2].is_empty() {
            session.last_mut().unwrap().replies.push(reply);
            continue;
        }
        let request = bytes(columns[2]);
        session.push(Exchange {
            operation: columns[0],
            value: bytes(columns[1]),
            by_soem: match columns[4] {
                "" => request.clone(),
                "-" => Vec::new(),
                other => bytes(other),
            },
            request,
            replies: vec![reply],
        });
    }
    assert!(session.len() >= 160);
    session
}

/// A device that knows the session by heart, and fails the test at any other message.
#[derive(Clone)]
struct Script(Rc<RefCell<State>>);

struct State {
    due: VecDeque<Exchange>,
    answers: VecDeque<Vec<u8>>,
}

impl MailboxTransport for Script {
    async fn write_message(&self, message: &[u8]) -> Result<bool, LinkFault> {
        let mut state = self.0.borrow_mut();
        let exchange = state.due.pop_front().expect("a message of the session");
        assert_eq!(message, exchange.request, "{}", exchange.operation);
        assert!(state.answers.is_empty(), "{}", exchange.operation);
        state.answers.extend(exchange.replies);
        Ok(true)
    }

    async fn read_message(&self, message: &mut [u8]) -> Result<bool, LinkFault> {
        let answer = self.0.borrow_mut().answers.pop_front();
        for (to, from) in message.iter_mut().zip(answer.iter().flatten()) {
            *to = *from;
        }
        Ok(answer.is_some())
    }

    async fn status(&self) -> Result<MailboxStatus, LinkFault> {
        Ok(MailboxStatus {
            request_pending: false,
            message_waiting: !self.0.borrow().answers.is_empty(),
            repeat_requested: false,
            repeat_done: false,
        })
    }

    async fn request_repeat(&self, _: bool) -> Result<(), LinkFault> {
        panic!("nothing was lost");
    }
}

/// `1C12h:1`, or `1018h` for its subindex 0.
fn object(text: &str) -> (u16, u8) {
    let (index, subindex) = text.split_once(':').unwrap_or((text, "0"));
    let index = u16::from_str_radix(index.trim_end_matches('h'), 16).unwrap();
    (index, subindex.parse().unwrap())
}

/// Does one operation of the session; what it brings, as bytes.
async fn perform(
    sdo: &SdoHandle,
    operation: &str,
    value: &[u8],
) -> Result<Option<Vec<u8>>, DriveError> {
    let (what, object_text) = operation.rsplit_once(' ').unwrap();
    let value = value.to_vec();
    if what == "list of kind" {
        let list = sdo.object_list(ListKind::Outputs).await?;
        return Ok(Some(list.into_iter().flat_map(u16::to_le_bytes).collect()));
    }
    let (index, subindex) = object(object_text);
    Ok(match what {
        "write" => {
            sdo.write_bytes(index, subindex, value).await?;
            None
        }
        "write all" => {
            sdo.write_complete(index, subindex, value).await?;
            None
        }
        "read" => Some(sdo.read_bytes(index, subindex).await?),
        "read all" => Some(sdo.read_complete(index, subindex).await?),
        "describe" => Some(sdo.describe_object(index).await?.name.into_bytes()),
        "entry" => {
            let entry = sdo.describe_entry(index, subindex).await?;
            let limits = [entry.default, entry.minimum, entry.maximum];
            let mut told = entry.data_type.0.to_le_bytes().to_vec();
            told.extend(entry.bits.to_le_bytes());
            told.extend(entry.access.0.to_le_bytes());
            told.extend(entry.unit.iter().flat_map(|unit| unit.to_le_bytes()));
            told.extend(limits.into_iter().flatten().flatten());
            told.extend(entry.name.bytes());
            Some(told)
        }
        other => panic!("{other}"),
    })
}

/// The abort code in a reply, if it is a refusal: of an SDO, or of a question.
fn refusal(reply: &[u8]) -> Option<AbortCode> {
    let refused = matches!((reply[7], reply[8]), (0x20, 0x80) | (0x80, 0x07));
    refused.then(|| AbortCode(u32::from_le_bytes(reply[12..16].try_into().unwrap())))
}

#[test]
fn the_client_sends_the_sessions_requests_and_understands_its_replies() {
    let mailbox = Mailbox {
        receive_offset: 0x1000,
        receive_length: MAILBOX,
        send_offset: 0x1100,
        send_length: MAILBOX,
        protocols: Protocols(4),
    };
    let id = DriveId {
        position: 0,
        name: "session".into(),
        identity: Identity::default(),
    };
    let script = Script(Rc::new(RefCell::new(State {
        due: session().into(),
        answers: VecDeque::new(),
    })));
    // Nothing takes time here but what waits in vain.
    let clock = crate::Ticks(Wire::new(personality::coupler()));
    let settings = MailboxSettings::new(&mailbox);
    let (client, sdo, _) = MailboxClient::new(script.clone(), clock, settings, id);
    let (mut done, mut refused) = (0, 0);
    let work = async {
        for exchange in session() {
            if exchange.operation == "segment" {
                continue;
            }
            let operation = exchange.operation;
            let result = perform(&sdo, operation, &exchange.value).await;
            match (refusal(&exchange.replies[0]), result) {
                (Some(code), Err(error)) => {
                    assert!(
                        matches!(error.error, SdoError::Aborted { .. }),
                        "{operation}: {error}"
                    );
                    assert_eq!(error.error.abort_code(), Some(code), "{operation}");
                    refused += 1;
                }
                (None, Ok(Some(read))) => assert_eq!(read, exchange.value, "{operation}"),
                (None, Ok(None)) => {}
                (_, other) => panic!("{operation}: {other:?}"),
            }
            done += 1;
        }
    };
    smol::block_on(smol::future::or(work, async {
        client.run().await;
        panic!("the client ended first");
    }));
    assert!(script.0.borrow().due.is_empty());
    assert!(done > 80 && refused == 9, "{done}, {refused} refused");
}

/// Sends each of these requests to the drive of the session and compares the replies.
fn replay(request: impl Fn(&Exchange) -> &[u8]) -> usize {
    let wire = Wire::new(Servo::generic().mailbox_bytes(MAILBOX).build());
    let mailbox = Sii::parse(&wire.sii_image()).unwrap().mailbox.unwrap();
    wire.pre_op(&mailbox);
    let mut sent = 0;
    for (number, exchange) in session().iter().enumerate() {
        let mut message = request(exchange).to_vec();
        if message.is_empty() {
            continue;
        }
        message.resize(usize::from(MAILBOX), 0);
        assert!(wire.datagram(APWR, mailbox.receive_offset, &message).1);
        sent += 1;
        for reply in &exchange.replies {
            let what = format!("request {number}, {}", exchange.operation);
            // Sync manager 1's status, bit 3: full.
            let full = (0..100).any(|_| wire.read(0x080D, 1)[0] & 0x08 != 0);
            assert!(full, "{what}: no answer");
            let answer = wire.read(mailbox.send_offset, usize::from(MAILBOX));
            let (answer, behind) = answer.split_at(reply.len());
            assert_eq!(answer, reply, "{what}");
            assert!(behind.iter().all(|byte| *byte == 0), "{what}");
        }
        assert_eq!(wire.read(0x080D, 1)[0] & 0x08, 0, "nothing else comes");
    }
    sent
}

#[test]
fn the_simulated_drive_answers_the_sessions_requests_with_its_replies() {
    assert_eq!(replay(|exchange| &exchange.request), session().len());
}

#[test]
fn the_simulated_drive_answers_soems_form_of_the_requests_alike() {
    let differing = session()
        .iter()
        .filter(|exchange| !exchange.by_soem.is_empty() && exchange.by_soem != exchange.request)
        .count();
    assert!(differing > 20, "{differing}");
    assert!(replay(|exchange| &exchange.by_soem) > 140);
}
