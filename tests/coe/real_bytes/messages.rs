//! The library's SDO codec on messages that SOEM and drives of others exchanged.

use servocrab::coe::mailbox::{Counter, MailboxMessage, sdo_message};
use servocrab::coe::sdo::{Download, SdoFault, TransferStep, Upload};
use servocrab::coe::{AbortCode, ObjectAddress};
use servocrab::pdo_map::{Entry, MappedPdo, Mapping};

use super::vectors::{Exchange, akd_exchanges, object, pp_drive_exchanges, simulated_exchanges};

/// Bytes of the mailbox header and the CoE header.
const HEADERS: usize = 8;
/// The other drive's mailboxes.
const PP_DRIVE_MAILBOX: usize = 128;

fn address(what: &str) -> ObjectAddress {
    let (index, subindex) = object(what);
    ObjectAddress::new(index, subindex)
}

/// The SDO in a reply, and the counter of its message.
fn sdo_reply(message: &[u8]) -> (u8, &[u8]) {
    match MailboxMessage::parse(message).unwrap() {
        (header, MailboxMessage::SdoReply(sdo)) => (header.counter, sdo),
        (_, other) => panic!("{other:?}"),
    }
}

fn request_of(download: &Download) -> Vec<u8> {
    let mut request = Vec::new();
    download.append_request(&mut request);
    request
}

#[test]
fn every_message_of_a_session_with_a_real_akd_is_encoded_and_decoded_alike() {
    let mut counter = Counter::FIRST;
    for exchange in akd_exchanges() {
        let mut upload = Upload::new(address(exchange.what));
        let mut message = Vec::new();
        sdo_message(&mut message, counter, |message| {
            message.extend_from_slice(&upload.request());
        });
        assert_eq!(message, exchange.request, "{}", exchange.what);
        let (answered, sdo) = sdo_reply(&exchange.reply);
        assert_eq!(answered, counter.get(), "{}", exchange.what);
        assert_eq!(
            upload.feed(sdo),
            Ok(TransferStep::Done),
            "{}",
            exchange.what
        );
        assert_eq!(upload.into_data(), exchange.value, "{}", exchange.what);
        counter = counter.next();
    }
    assert_eq!(akd_exchanges().len(), 35);
}

#[test]
fn every_reply_of_a_real_akd_is_refused_when_cut_and_foreign_to_another_object() {
    for exchange in akd_exchanges() {
        for length in 0..exchange.reply.len() {
            assert!(MailboxMessage::parse(&exchange.reply[..length]).is_err());
        }
        let (_, sdo) = sdo_reply(&exchange.reply);
        let mut other = Upload::new(ObjectAddress::new(0x6041, 0));
        assert_eq!(
            other.feed(sdo),
            Ok(TransferStep::Foreign),
            "{}",
            exchange.what
        );
    }
}

#[test]
fn the_mapping_of_a_real_akd_is_the_one_that_its_eeprom_does_not_say() {
    let exchanges = akd_exchanges();
    let value = |index: u16, subindex: u8| {
        let read = exchanges
            .iter()
            .find(|exchange| object(exchange.what) == (index, subindex));
        let mut bytes = read.expect("SOEM has read it").value.clone();
        bytes.resize(4, 0);
        u32::from_le_bytes(bytes.try_into().unwrap())
    };
    let assigned = |assignment: u16| {
        (1..=value(assignment, 0) as u8)
            .map(|at| value(assignment, at) as u16)
            .map(|index| MappedPdo {
                index,
                entries: (1..=value(index, 0) as u8)
                    .map(|at| Entry::from_raw(value(index, at)))
                    .collect(),
            })
            .collect::<Vec<_>>()
    };
    let pdo = |index, objects: &[(u16, u8)]| MappedPdo {
        index,
        entries: objects
            .iter()
            .map(|&(object, bits)| Entry::new(object, 0, bits))
            .collect(),
    };
    let (outputs, inputs) = (assigned(0x1C12), assigned(0x1C13));
    assert_eq!(
        outputs,
        [
            pdo(0x1600, &[(0x6040, 16)]),
            pdo(0x1601, &[(0x6040, 16), (0x6060, 8)]),
            pdo(0x1602, &[(0x6040, 16), (0x607A, 32)]),
            pdo(0x1603, &[(0x6040, 16), (0x60FF, 32)]),
        ]
    );
    assert_eq!(
        inputs,
        [
            pdo(0x1A00, &[(0x6041, 16)]),
            pdo(0x1A01, &[(0x6041, 16), (0x6061, 8)]),
            pdo(0x1A02, &[(0x6041, 16), (0x6064, 32)]),
            pdo(0x1A03, &[(0x6041, 16), (0x606C, 32)]),
        ]
    );
    let layout = Mapping::from_pdos(outputs, inputs).layout();
    assert_eq!((layout.output_bytes(), layout.input_bytes()), (17, 17));
}

/// The rows from the one that begins with `what` on, with its segments.
fn transfer<'a>(exchanges: &'a [Exchange], what: &str) -> Vec<&'a Exchange> {
    let first = exchanges
        .iter()
        .position(|exchange| exchange.what == what)
        .unwrap();
    let mut rows = vec![&exchanges[first]];
    rows.extend(
        exchanges[first + 1..]
            .iter()
            .take_while(|exchange| exchange.what.contains("segment")),
    );
    rows
}

/// Uploads as SOEM did; SOEM repeats the object in requests for segments, where the standard has reserved bytes.
fn upload(what: &str) -> Vec<u8> {
    let exchanges = pp_drive_exchanges();
    let mut upload = Upload::new(address(what.strip_prefix("upload ").unwrap()));
    let rows = transfer(&exchanges, what);
    for (at, row) in rows.iter().enumerate() {
        let mut expected = row.request[HEADERS..].to_vec();
        if at > 0 {
            expected[1..4].fill(0);
        }
        assert_eq!(upload.request()[..], expected, "{what}, request {at}");
        let step = if at + 1 == rows.len() {
            TransferStep::Done
        } else {
            TransferStep::More
        };
        assert_eq!(
            upload.feed(sdo_reply(&row.reply).1),
            Ok(step),
            "{what}, reply {at}"
        );
    }
    upload.into_data()
}

#[test]
fn uploads_of_every_kind_are_asked_for_as_soem_does_and_understood() {
    assert_eq!(upload("upload 1000h:0"), [0x92, 0x01, 0x02, 0x00]);
    assert_eq!(upload("upload 1008h:0"), b"PP-SIM");
    assert_eq!(upload("upload 6081h:0"), 200_000u32.to_le_bytes());
    let digits: Vec<u8> = b"0123456789".iter().copied().cycle().take(600).collect();
    assert_eq!(upload("upload 2000h:0"), digits, "in six segments");
    // What that slave kept of the download below.
    let kept = upload("upload 2001h:0");
    assert_eq!((kept.len(), &kept[..188]), (300, &[b'z'; 188][..]));
}

#[test]
fn a_download_in_segments_is_cut_into_messages_as_soem_cuts_it() {
    let exchanges = pp_drive_exchanges();
    let object = address("2001h:0");
    let mut download = Download::new(object, vec![b'z'; 300], PP_DRIVE_MAILBOX);
    let rows = transfer(&exchanges, "download 2001h:0");
    for (at, row) in rows.iter().enumerate() {
        assert_eq!(
            request_of(&download),
            row.request[HEADERS..],
            "request {at}"
        );
        let (_, sdo) = sdo_reply(&row.reply);
        // Replies to segments have 1 byte from that slave, where the standard has 8.
        let mut whole = sdo.to_vec();
        if at > 0 {
            assert!(matches!(download.feed(sdo), Err(SdoFault::Cut(_))));
            whole.resize(8, 0);
        } else {
            whole.truncate(8);
        }
        let step = if at + 1 == rows.len() {
            TransferStep::Done
        } else {
            TransferStep::More
        };
        assert_eq!(download.feed(&whole), Ok(step), "reply {at}");
    }
    assert_eq!(rows.len(), 3);
}

#[test]
fn an_expedited_download_is_encoded_as_by_soem() {
    let exchanges = pp_drive_exchanges();
    let row = transfer(&exchanges, "download 6081h:0")[0];
    let value = 200_000u32.to_le_bytes().to_vec();
    let mut download = Download::new(address("6081h:0"), value, PP_DRIVE_MAILBOX);
    assert_eq!(request_of(&download), row.request[HEADERS..]);
    assert_eq!(
        download.feed(sdo_reply(&row.reply).1),
        Ok(TransferStep::Done)
    );
}

#[test]
fn refusals_are_understood_with_a_requests_bits_left_in_their_command_too() {
    let exchanges = pp_drive_exchanges();
    let aborted = |what: &str, request: &[u8], code| {
        let row = exchanges
            .iter()
            .rfind(|exchange| exchange.what == what)
            .unwrap();
        assert_eq!(request, &row.request[HEADERS..], "{what}");
        (
            row,
            Err::<TransferStep, _>(SdoFault::Aborted(AbortCode(code))),
        )
    };
    for (what, code) in [("5555h:0", 0x0602_0000), ("1018h:9", 0x0609_0011)] {
        let mut upload = Upload::new(address(what));
        let (row, refusal) = aborted(&format!("upload {what}"), &upload.request(), code);
        assert_eq!(upload.feed(sdo_reply(&row.reply).1), refusal, "{what}");
    }
    // 8Bh in place of 80h: a slave's mistake that must not hide the reason.
    for (what, code) in [("6041h:0", 0x0601_0002), ("6081h:0", 0x0607_0010)] {
        let mut download = Download::new(address(what), vec![0, 0], PP_DRIVE_MAILBOX);
        let (row, refusal) = aborted(&format!("download {what}"), &request_of(&download), code);
        assert_eq!(row.reply[HEADERS], 0x8B);
        assert_eq!(download.feed(sdo_reply(&row.reply).1), refusal, "{what}");
    }
}

#[test]
fn sdo_information_is_told_apart_from_sdo_replies() {
    let asked = pp_drive_exchanges();
    let information = asked.iter().filter(|exchange| {
        ["list", "description", "entry"].contains(&exchange.what.split([' ']).next().unwrap())
    });
    let mut seen = 0;
    for exchange in information {
        let (_, message) = MailboxMessage::parse(&exchange.reply).unwrap();
        assert_eq!(
            message,
            MailboxMessage::SdoInformation(&exchange.reply[HEADERS..])
        );
        seen += 1;
    }
    assert_eq!(seen, 11);
}

#[test]
fn the_simulated_drives_answers_are_understood() {
    let exchanges = simulated_exchanges();
    let read = |what: &str| {
        let mut upload = Upload::new(address(what.strip_prefix("upload ").unwrap()));
        let steps = transfer(&exchanges, what);
        let fed: Vec<_> = steps
            .iter()
            .map(|row| upload.feed(sdo_reply(&row.reply).1))
            .collect();
        (fed, upload.into_data())
    };
    let done = |value: &[u8]| (vec![Ok(TransferStep::Done)], value.to_vec());
    assert_eq!(read("upload 1000h:0"), done(&0x0002_0192u32.to_le_bytes()));
    assert_eq!(read("upload 1008h:0"), done(b"AKD2G EtherCAT Drive (CoE)"));
    assert_eq!(
        read("upload 5F00h:0"),
        (
            vec![
                Ok(TransferStep::More),
                Ok(TransferStep::More),
                Ok(TransferStep::Done)
            ],
            vec![b'z'; 300]
        )
    );
    for (what, code) in [
        ("upload 5555h:0", 0x0602_0000),
        ("upload 1018h:9", 0x0609_0011),
    ] {
        let refused = vec![Err(SdoFault::Aborted(AbortCode(code)))];
        assert_eq!(read(what).0, refused, "{what}");
    }
    let mut download = Download::new(address("5F00h:0"), vec![b'z'; 300], PP_DRIVE_MAILBOX);
    for row in transfer(&exchanges, "download 5F00h:0") {
        assert_eq!(request_of(&download), row.request[HEADERS..]);
        assert!(download.feed(sdo_reply(&row.reply).1).is_ok());
    }
    assert!(!download.is_segmented(), "it is over");
}
