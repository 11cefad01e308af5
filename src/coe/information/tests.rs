//! Dialogues of SDO information. Bytes named SOEM are of a session of SOEM with a simulated drive made with KickCAT, from the
//! byte behind the CoE header on.

use super::*;
use crate::coe::data_type::TypeCode;
use crate::coe::object::{Mappable, ObjectAddress};
use alloc::{string::ToString, vec};
use proptest::prelude::*;

const VENDOR: Question = Question::Entry {
    index: 0x1018,
    subindex: 1,
    wanted: Question::BASICS,
};

/// One fragment of an answer.
fn fragment(operation: u8, left: u16, data: &[u8]) -> Vec<u8> {
    let more = if left > 0 { INCOMPLETE } else { 0 };
    let mut mail = vec![operation | more, 0];
    mail.extend(left.to_le_bytes());
    mail.extend(data);
    mail
}

fn list_of(words: &[u16]) -> Vec<u8> {
    words.iter().flat_map(|word| word.to_le_bytes()).collect()
}

#[test]
fn questions_are_asked_as_soem_asks_them() {
    let request = |question| {
        let mut request = Vec::new();
        Inquiry::new(question).append_request(&mut request);
        request
    };
    assert_eq!(request(Question::List(ListKind::All)), [1, 0, 0, 0, 1, 0]);
    assert_eq!(
        request(Question::Object { index: 0x607D }),
        [3, 0, 0, 0, 0x7D, 0x60]
    );
    assert_eq!(request(VENDOR), [5, 0, 0, 0, 0x18, 0x10, 1, 7]);
    assert_eq!(request(Question::Counts), [1, 0, 0, 0, 0, 0]);
}

#[test]
fn descriptions_that_soem_read_are_understood() {
    let mut inquiry = Inquiry::new(Question::Object { index: 0x607D });
    let answer = b"\x04\0\0\0\x7D\x60\x05\x00\x02\x09Software position limit";
    assert_eq!(inquiry.feed(answer), Ok(Step::Done));
    assert_eq!(
        ObjectDescription::parse(&inquiry.into_data()),
        Ok(ObjectDescription {
            index: 0x607D,
            data_type: TypeCode(5),
            max_subindex: 2,
            code: ObjectCode::Record,
            name: "Software position limit".into(),
        })
    );
    let mut inquiry = Inquiry::new(VENDOR);
    assert_eq!(
        inquiry.feed(b"\x06\0\0\0\x18\x10\x01\x00\x07\x00\x20\x00\x07\x00Vendor"),
        Ok(Step::Done)
    );
    let entry = EntryDescription::parse(&inquiry.into_data()).unwrap();
    assert_eq!(entry.address, ObjectAddress::new(0x1018, 1));
    assert_eq!((entry.data_type, entry.bits), (TypeCode(7), 32));
    assert_eq!(entry.access, EntryAccess(7));
    assert_eq!((entry.name.as_str(), entry.default), ("Vendor", None));
}

#[test]
fn unit_default_and_limits_stand_in_front_of_the_name_as_far_as_they_are_told() {
    // ETG.1000.6, entry description: value info 78h, an INTEGER16 with unit, -1, -2 and 3.
    let head = [0x81, 0x60, 0, 0x78, 3, 0, 16, 0, 0x7F, 0x01];
    let values = [0, 0, 0xB5, 0, 0xFF, 0xFF, 0xFE, 0xFF, 3, 0];
    let answer = [&head[..], &values, b"Name\0\0"].concat();
    let entry = EntryDescription::parse(&answer).unwrap();
    assert_eq!(entry.unit, Some(0x00B5_0000));
    assert_eq!(entry.default, Some(vec![0xFF, 0xFF]));
    assert_eq!(entry.minimum, Some(vec![0xFE, 0xFF]));
    assert_eq!(entry.maximum, Some(vec![3, 0]));
    assert_eq!(entry.name, "Name");
    assert_eq!(
        entry.access.mappable(),
        Mappable {
            outputs: true,
            inputs: false
        }
    );
    assert!(entry.access.backup() && !entry.access.settings());
    for length in 0..head.len() + values.len() {
        assert!(
            matches!(
                EntryDescription::parse(&answer[..length]),
                Err(SdoFault::Cut(_))
            ),
            "{length} bytes"
        );
    }
}

#[test]
fn access_is_told_per_state() {
    // PREOP and SAFEOP readable, PREOP writable; a real EL7's 1600h:1 has 050Fh.
    let access = EntryAccess(0x050F);
    assert!(access.readable_in_op() && access.readable_in_safe_op());
    assert!(access.writable_in_pre_op());
    assert!(!access.writable_in_safe_op() && !access.writable_in_op());
    assert_eq!(access.to_string(), "rw, written in PREOP only, backup");
    assert_eq!(
        EntryAccess(0x0003).to_string(),
        "ro, read in PREOP and SAFEOP only"
    );
    assert_eq!(EntryAccess(0).to_string(), "no access");
}

#[test]
fn a_list_is_put_together_from_its_fragments_wherever_they_are_cut() {
    let words: Vec<u16> = [1].into_iter().chain(0x6040..0x6060).collect();
    let whole = list_of(&words);
    for room in 2..whole.len() + 2 {
        let mut inquiry = Inquiry::new(Question::List(ListKind::All));
        let pieces: Vec<_> = whole.chunks(room).collect();
        for (at, piece) in pieces.iter().enumerate() {
            let left = (pieces.len() - at - 1) as u16;
            let due = if left == 0 { Step::Done } else { Step::More };
            assert_eq!(inquiry.feed(&fragment(2, left, piece)), Ok(due));
            assert_eq!(inquiry.is_under_way(), left > 0);
        }
        assert_eq!(object_list(&inquiry.into_data()).unwrap(), words[1..]);
    }
}

#[test]
fn a_list_that_ends_within_an_index_is_cut() {
    assert!(matches!(object_list(&[1, 0, 0x40]), Err(SdoFault::Cut(_))));
    assert!(matches!(object_list(&[]), Err(SdoFault::Cut(_))));
    assert_eq!(object_list(&[1, 0]), Ok(vec![]));
    let counts = object_counts(&list_of(&[0, 300, 20, 30, 4, 5])).unwrap();
    assert_eq!((counts.all, counts.outputs, counts.inputs), (300, 20, 30));
    assert_eq!((counts.backup, counts.settings), (4, 5));
    assert!(object_counts(&list_of(&[0, 300, 20, 30, 4])).is_err());
}

#[test]
fn a_missing_a_doubled_and_an_endless_fragment_are_errors() {
    let start = || {
        let mut inquiry = Inquiry::new(Question::List(ListKind::All));
        let first = inquiry.feed(&fragment(2, 3, &[1, 0, 0x40, 0x60]));
        assert_eq!(first, Ok(Step::More));
        inquiry
    };
    for got in [0, 1, 3, 4, u16::MAX] {
        assert_eq!(
            start().feed(&fragment(2, got, &[0x41, 0x60])),
            Err(SdoFault::Fragments { expected: 2, got })
        );
    }
    // Bit 7 says that more follow, the number says none.
    let endless = [0x82, 0, 0, 0, 1, 0];
    assert!(matches!(
        Inquiry::new(Question::List(ListKind::All)).feed(&endless),
        Err(SdoFault::Fragments { .. })
    ));
    // A device that leaves bit 7 out is understood by the number.
    let mut bare = Inquiry::new(Question::List(ListKind::All));
    assert_eq!(bare.feed(&[2, 0, 1, 0, 1, 0]), Ok(Step::More));
    assert_eq!(bare.feed(&[2, 0, 0, 0, 0x40, 0x60]), Ok(Step::Done));
}

#[test]
fn answers_to_other_questions_are_foreign() {
    let mut inquiry = Inquiry::new(VENDOR);
    for other in [
        &b"\x06\0\0\0\x18\x10\x02\x00\x07\x00\x20\x00\x07\x00"[..],
        b"\x06\0\0\0\x19\x10\x01\x00\x07\x00\x20\x00\x07\x00",
        b"\x04\0\0\0\x18\x10\x05\x00\x04\x09Identity",
        b"\x82\0\x01\0\x01\x00",
        b"\x05\0\0\0\x18\x10\x01\x07",
    ] {
        assert_eq!(inquiry.feed(other), Ok(Step::Foreign), "{other:02X?}");
    }
    let mut list = Inquiry::new(Question::List(ListKind::Inputs));
    assert_eq!(list.feed(&fragment(2, 0, &[1, 0])), Ok(Step::Foreign));
}

#[test]
fn a_refusal_has_its_reason_at_every_place() {
    // ETG.1000.6, SDO information error: the abort code behind the header.
    let refusal = fragment(7, 0, &[0x11, 0, 9, 6]);
    let aborted = Err(SdoFault::Aborted(AbortCode::NO_SUBINDEX));
    assert_eq!(Inquiry::new(VENDOR).feed(&refusal), aborted);
    let mut list = Inquiry::new(Question::List(ListKind::All));
    assert_eq!(list.feed(&fragment(2, 1, &[1, 0])), Ok(Step::More));
    assert_eq!(list.feed(&refusal), aborted);
    for length in 0..refusal.len() {
        assert!(matches!(
            Inquiry::new(VENDOR).feed(&refusal[..length]),
            Err(SdoFault::Cut(_))
        ));
    }
}

#[test]
fn an_answer_longer_than_any_list_is_refused() {
    let mut inquiry = Inquiry::new(Question::List(ListKind::All));
    let mut left = u16::MAX;
    let mut taken = 0;
    let piece = [1, 0].repeat(700);
    loop {
        match inquiry.feed(&fragment(2, left, &piece)) {
            Ok(step) => assert_eq!(step, Step::More),
            Err(fault) => break assert!(matches!(fault, SdoFault::Size { .. })),
        }
        taken += piece.len();
        left -= 1;
    }
    assert!(taken <= LONGEST_INFORMATION);
}

#[test]
fn a_description_may_be_shorter_than_a_list() {
    for (question, operation, longest) in [
        (Question::List(ListKind::All), 2, LONGEST_INFORMATION),
        (VENDOR, 6, LONGEST_DESCRIPTION),
    ] {
        let mut inquiry = Inquiry::new(question);
        let (mut left, mut got) = (u16::MAX, 0);
        let fault = loop {
            let mut mail = vec![operation | 0x80, 0];
            mail.extend(left.to_le_bytes());
            let (names, length) = question.names();
            mail.extend(names.iter().take(if left == u16::MAX { length } else { 0 }));
            mail.resize(1000, b'x');
            got += mail.len() - 4;
            match inquiry.feed(&mail) {
                Ok(step) => assert_eq!(step, Step::More),
                Err(fault) => break fault,
            }
            left -= 1;
        };
        let expected = longest;
        assert_eq!(fault, SdoFault::Size { expected, got });
        assert!(got - longest < 1000);
    }
}

proptest! {
    #[test]
    fn any_mails_are_decoded_without_panic_and_within_the_bound(
        mails in prop::collection::vec(prop::collection::vec(any::<u8>(), 0..40), 0..20),
        which in 0u8..4,
    ) {
        let question = match which {
            0 => Question::Counts,
            1 => Question::List(ListKind::All),
            2 => Question::Object { index: 0x1018 },
            _ => VENDOR,
        };
        let mut inquiry = Inquiry::new(question);
        let mut bytes = 0;
        for mail in mails {
            bytes += mail.len();
            let _ = inquiry.feed(&mail);
        }
        let answer = inquiry.into_data();
        prop_assert!(answer.len() <= bytes.min(LONGEST_INFORMATION));
    }

    #[test]
    fn any_answer_is_decoded_without_panic_and_to_no_more_than_it_has(answer in prop::collection::vec(any::<u8>(), 0..200)) {
        if let Ok(object) = ObjectDescription::parse(&answer) {
            // A byte that is no text becomes a replacement character of three.
            prop_assert!(object.name.len() <= 3 * answer.len());
        }
        if let Ok(entry) = EntryDescription::parse(&answer) {
            let values = [&entry.default, &entry.minimum, &entry.maximum];
            let held: usize = values.into_iter().flatten().map(Vec::len).sum();
            prop_assert!(held <= answer.len());
        }
        if let Ok(list) = object_list(&answer) {
            prop_assert!(2 * list.len() <= answer.len());
        }
        let _ = object_counts(&answer);
    }
}
