//! SDO transfers of both directions, answered by any replies: expedited, normal, segmented, complete access.

use servocrab::coe::ObjectAddress;
use servocrab::coe::mailbox::SHORTEST_MAILBOX;
use servocrab::coe::sdo::{Download, LONGEST_OBJECT, TransferStep, Upload};

use super::Script;
use super::memory::within;

/// The object of every transfer; replies of the seeds name it.
pub const OBJECT: ObjectAddress = ObjectAddress::new(0x1008, 0);

/// The first byte chooses the transfer: bit 0 a download, bit 1 complete access, bit 2 an upload of known width.
pub fn run(data: &[u8]) {
    let mut script = Script(data);
    let kind = script.byte();
    if kind & 1 == 0 {
        upload(kind, script);
    } else {
        download(kind, script);
    }
}

/// An upload holds at most four times the bytes that came, whatever size they announce; each reply brings a byte or ends it.
fn upload(kind: u8, mut script: Script<'_>) {
    let mut upload = Upload::new(OBJECT);
    if kind & 2 != 0 {
        upload = upload.complete_access();
    }
    if kind & 4 != 0 {
        upload = upload.width(usize::from(script.byte()));
    }
    let came: usize = script.map(<[u8]>::len).sum();
    within(64 + 4 * came, || {
        let (mut more, mut over) = (0, false);
        for reply in script {
            let request = upload.request();
            match upload.feed(reply) {
                _ if over => {}
                Ok(TransferStep::More) => more += 1,
                Ok(TransferStep::Foreign) => assert_eq!(upload.request(), request),
                Ok(TransferStep::Done) => over = true,
                Err(fault) => {
                    let _ = fault.abort_code();
                    over = true;
                }
            }
        }
        let data = upload.into_data();
        assert!(data.len() <= came.min(LONGEST_OBJECT));
        assert!(
            more <= 1 + data.len(),
            "{more} replies for {} bytes",
            data.len()
        );
    });
}

/// A download holds at most three times what it writes; no request is longer than the mailbox.
fn download(kind: u8, mut script: Script<'_>) {
    let (length, mailbox) = (usize::from(script.word()), usize::from(script.word()));
    let room = mailbox.max(SHORTEST_MAILBOX) - 8;
    within(64 + 3 * length, || {
        let mut download = Download::new(OBJECT, vec![0xA5; length], mailbox);
        if kind & 2 != 0 {
            download = download.complete_access();
        }
        let (mut more, mut over) = (0, false);
        for reply in script {
            let request = request_of(&download);
            assert!((8..=room).contains(&request.len()), "{}", request.len());
            match download.feed(reply) {
                _ if over => {}
                Ok(TransferStep::More) => more += 1,
                Ok(TransferStep::Foreign) => assert_eq!(request_of(&download), request),
                Ok(TransferStep::Done) | Err(_) => over = true,
            }
        }
        assert!(more <= 1 + length, "{more} replies for {length} bytes");
    });
}

fn request_of(download: &Download) -> Vec<u8> {
    let mut request = Vec::new();
    download.append_request(&mut request);
    request
}
