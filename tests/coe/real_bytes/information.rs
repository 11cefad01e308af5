//! The library's SDO information on messages that SOEM exchanged with a drive of others, and with the simulated AKD2G.

use servocrab::coe::TypeCode;
use servocrab::coe::information::{
    EntryDescription, Inquiry, ListKind, ObjectCode, ObjectDescription, Question, object_list,
};
use servocrab::coe::mailbox::{Counter, MailboxMessage, information_message};
use servocrab::coe::sdo::TransferStep;

use super::vectors::{Exchange, number, object, pp_drive_exchanges, simulated_exchanges};

/// What the row asks; none if it is no SDO information.
fn question(what: &str) -> Option<Question> {
    if what == "list of objects, kind 1" {
        return Some(Question::List(ListKind::All));
    }
    if let Some(index) = what.strip_prefix("description of ") {
        let index = number(index);
        return Some(Question::Object { index });
    }
    let entry = what.strip_prefix("entry ")?;
    let (index, subindex) = object(entry.strip_suffix(", value info 07h")?);
    Some(Question::Entry {
        index,
        subindex,
        wanted: Question::BASICS,
    })
}

fn counter_of(message: &[u8]) -> Counter {
    let mut counter = Counter::FIRST;
    while counter.get() != message[5] >> 4 {
        counter = counter.next();
    }
    counter
}

/// The answer in a row's reply, once its request was encoded as SOEM encoded it.
fn answer(row: &Exchange, question: Question) -> Vec<u8> {
    let mut inquiry = Inquiry::new(question);
    let mut message = Vec::new();
    information_message(&mut message, counter_of(&row.request), |message| {
        inquiry.append_request(message);
    });
    assert_eq!(message, row.request, "{}", row.what);
    let (_, MailboxMessage::SdoInformation(message)) = MailboxMessage::parse(&row.reply).unwrap()
    else {
        panic!("{} is answered by another service", row.what);
    };
    for length in 0..4 {
        assert!(Inquiry::new(question).feed(&message[..length]).is_err());
    }
    assert_eq!(
        inquiry.feed(message),
        Ok(TransferStep::Done),
        "{}",
        row.what
    );
    inquiry.into_data()
}

#[test]
fn every_question_is_encoded_as_by_soem_and_every_answer_understood() {
    for (exchanges, expected) in [(pp_drive_exchanges(), 11), (simulated_exchanges(), 10)] {
        let mut seen = 0;
        for row in &exchanges {
            let Some(question) = question(row.what) else {
                continue;
            };
            let answer = answer(row, question);
            match question {
                Question::Object { index } => {
                    let object = ObjectDescription::parse(&answer).unwrap();
                    assert_eq!(object.index, index);
                    assert!(row.reply.ends_with(object.name.as_bytes()));
                    assert!(!object.name.is_empty(), "{}", row.what);
                }
                Question::Entry {
                    index, subindex, ..
                } => {
                    let entry = EntryDescription::parse(&answer).unwrap();
                    assert_eq!(
                        (entry.address.index, entry.address.subindex),
                        (index, subindex)
                    );
                    assert!(row.reply.ends_with(entry.name.as_bytes()));
                    assert!(entry.access.readable() && !entry.access.writable());
                    let width = if subindex == 0 {
                        (TypeCode(5), 8)
                    } else {
                        (TypeCode(7), 32)
                    };
                    assert_eq!((entry.data_type, entry.bits), width, "{}", row.what);
                }
                Question::List(_) | Question::Counts => {
                    let list = object_list(&answer).unwrap();
                    assert_eq!((list[0], list.len()), (0x1000, 33), "{list:04X?}");
                }
            }
            seen += 1;
        }
        assert_eq!(seen, expected);
    }
}

#[test]
fn the_kinds_of_objects_are_told_apart() {
    let exchanges = pp_drive_exchanges();
    let described = |what: &str| {
        let row = exchanges.iter().find(|row| row.what == what).unwrap();
        ObjectDescription::parse(&answer(row, question(what).unwrap())).unwrap()
    };
    let device_type = described("description of 1000h");
    assert_eq!(device_type.code, ObjectCode::Variable);
    assert_eq!(
        (device_type.data_type, device_type.max_subindex),
        (TypeCode(7), 0)
    );
    let identity = described("description of 1018h");
    assert_eq!(
        (identity.code, identity.max_subindex),
        (ObjectCode::Record, 4)
    );
    assert_eq!(identity.name, "Identity");
    let target = described("description of 607Ah");
    assert_eq!(
        (target.data_type, target.name.as_str()),
        (TypeCode(4), "Target position")
    );
}
