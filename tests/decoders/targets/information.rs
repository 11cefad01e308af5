//! SDO information: a question, answered by any fragments, and the decoding of the answer.

use servocrab::coe::information::{
    EntryDescription, Inquiry, ListKind, ObjectDescription, Question, object_counts, object_list,
};
use servocrab::coe::sdo::TransferStep;

use super::Script;
use super::memory::within;

/// The questions, chosen by the first byte.
const QUESTIONS: [Question; 6] = [
    Question::Counts,
    Question::List(ListKind::All),
    Question::List(ListKind::Settings),
    Question::Object { index: 0x1018 },
    Question::Entry {
        index: 0x1018,
        subindex: 1,
        wanted: Question::EVERYTHING,
    },
    Question::Entry {
        index: 0x6081,
        subindex: 0,
        wanted: Question::BASICS,
    },
];

/// An answer holds at most four times the bytes that came; what is decoded from it at most eight times, and a value's text 64 times.
pub fn run(data: &[u8]) {
    let mut script = Script(data);
    let question = QUESTIONS[usize::from(script.byte()) % QUESTIONS.len()];
    let came: usize = script.map(<[u8]>::len).sum();
    let answer = within(64 + 4 * came, || {
        let mut inquiry = Inquiry::new(question);
        let mut request = Vec::new();
        inquiry.append_request(&mut request);
        assert!(request.len() >= 6);
        let mut fragments = 0;
        for message in script {
            fragments += 1;
            match inquiry.feed(message) {
                Ok(TransferStep::More) => assert!(inquiry.is_under_way()),
                Ok(TransferStep::Foreign) => fragments -= 1,
                Ok(TransferStep::Done) => {
                    assert!(fragments <= 0x1_0000);
                    return inquiry.into_data();
                }
                Err(_) => break,
            }
        }
        let _ = inquiry.clone();
        inquiry.into_data()
    });
    assert!(answer.len() <= came);
    decode(&answer);
    // What a device may send in one fragment, without its header.
    decode(data);
}

fn decode(answer: &[u8]) {
    let bound = 64 + 8 * answer.len();
    if let Ok(list) = within(bound, || object_list(answer)) {
        assert_eq!(2 * list.len() + 2, answer.len());
    }
    let _ = within(bound, || object_counts(answer));
    if let Ok(object) = within(bound, || ObjectDescription::parse(answer)) {
        let _ = (object.code.to_string(), object.data_type.to_string());
    }
    if let Ok(entry) = within(bound, || EntryDescription::parse(answer)) {
        let _ = (entry.access.to_string(), entry.data_type.to_string());
        for value in [&entry.default, &entry.minimum, &entry.maximum]
            .into_iter()
            .flatten()
        {
            assert_eq!(value.len(), usize::from(entry.bits.div_ceil(8)));
            within(1024 + 64 * value.len(), || entry.data_type.show(value));
        }
    }
}
