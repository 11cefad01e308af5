//! Questions about a drive's object dictionary (SDO information).

use alloc::vec::Vec;

use super::SdoHandle;
use crate::coe::abort::AbortCode;
use crate::coe::client::Dialogue;
use crate::coe::dictionary::{DictionaryObject, ObjectDictionary, Undescribed};
use crate::coe::error::{DriveError, SdoError, Transfer};
use crate::coe::information::{
    EntryDescription, Inquiry, ListKind, ObjectCounts, ObjectDescription, Question, object_counts,
    object_list,
};
use crate::coe::sdo::SdoFault;

/// Bytes that a dictionary may take. Drives have up to some thousands of entries, of some hundred bytes each.
const MOST_BYTES: usize = 16 << 20;

impl SdoHandle {
    /// Reads the drive's whole object dictionary: its list of objects, and what each object and each entry is.
    ///
    /// It takes one message and its answer for every object and every entry: seconds, on a drive with a thousand of them. What the
    /// drive lists but does not describe is listed apart ([`ObjectDictionary::undescribed`]).
    ///
    /// # Errors
    /// [`SdoError::NotSupported`] if the drive has no SDO information. Else as [`SdoHandle::read`], and `Fragments` where a part of
    /// an answer is missing. `WrongSize` if the descriptions take more than 16 MiB, as no drive's do.
    pub async fn dictionary(&self) -> Result<ObjectDictionary, DriveError> {
        self.dictionary_within(MOST_BYTES).await
    }

    pub(in crate::coe) async fn dictionary_within(
        &self,
        most: usize,
    ) -> Result<ObjectDictionary, DriveError> {
        let mut dictionary = ObjectDictionary::default();
        let mut held = 0;
        let mut hold = |bytes: usize| {
            held += bytes;
            let transfer = Transfer::from(Question::List(ListKind::All));
            let fault = SdoFault::Size {
                expected: most,
                got: held,
            };
            (held <= most)
                .then_some(())
                .ok_or_else(|| self.error(SdoError::from_fault(transfer, fault)))
        };
        for index in self.object_list(ListKind::All).await? {
            let object = self.describe_object(index).await;
            let description = match refusal(object)? {
                Ok(description) => description,
                Err(code) => {
                    hold(size_of::<Undescribed>())?;
                    dictionary.undescribed.push(Undescribed {
                        index,
                        subindex: None,
                        code,
                    });
                    continue;
                }
            };
            hold(size_of::<DictionaryObject>() + description.name.len())?;
            let mut entries = Vec::new();
            for subindex in 0..=description.max_subindex {
                match refusal(self.describe_entry(index, subindex).await)? {
                    Ok(entry) => {
                        hold(entry.bytes())?;
                        entries.push(entry);
                    }
                    Err(AbortCode::NO_SUBINDEX) => {}
                    Err(code) => {
                        hold(size_of::<Undescribed>())?;
                        dictionary.undescribed.push(Undescribed {
                            index,
                            subindex: Some(subindex),
                            code,
                        });
                    }
                }
            }
            dictionary.objects.push(DictionaryObject {
                description,
                entries,
            });
        }
        Ok(dictionary)
    }

    /// How many objects the drive's lists have.
    ///
    /// # Errors
    /// As [`SdoHandle::dictionary`].
    pub async fn object_counts(&self) -> Result<ObjectCounts, DriveError> {
        self.ask(Question::Counts, object_counts).await
    }

    /// The indices of the objects of a list, in the drive's order.
    ///
    /// # Errors
    /// As [`SdoHandle::dictionary`].
    pub async fn object_list(&self, kind: ListKind) -> Result<Vec<u16>, DriveError> {
        self.ask(Question::List(kind), object_list).await
    }

    /// What an object is.
    ///
    /// # Errors
    /// As [`SdoHandle::dictionary`]; `Aborted` for an object that the drive does not have.
    pub async fn describe_object(&self, index: u16) -> Result<ObjectDescription, DriveError> {
        self.ask(Question::Object { index }, ObjectDescription::parse)
            .await
    }

    /// What an entry of an object is, with unit, default and limits as far as the drive reports them.
    ///
    /// # Errors
    /// As [`SdoHandle::dictionary`]; `Aborted` for an entry that the drive does not have.
    pub async fn describe_entry(
        &self,
        index: u16,
        subindex: u8,
    ) -> Result<EntryDescription, DriveError> {
        let question = |wanted| Question::Entry {
            index,
            subindex,
            wanted,
        };
        let parse = EntryDescription::parse;
        match self.ask(question(Question::EVERYTHING), parse).await {
            // A drive may refuse what it does not know of an entry, or say that it reports it and not do so.
            Err(DriveError {
                error: SdoError::Aborted { code, .. },
                ..
            }) if code != AbortCode::NO_SUBINDEX && code != AbortCode::NO_OBJECT => {}
            Err(DriveError {
                error: SdoError::Cut { .. },
                ..
            }) => {}
            other => return other,
        }
        self.ask(question(Question::BASICS), parse).await
    }

    async fn ask<T>(
        &self,
        question: Question,
        parse: impl Fn(&[u8]) -> Result<T, SdoFault>,
    ) -> Result<T, DriveError> {
        let transfer = Transfer::from(question);
        let inquiry = Inquiry::new(question).with_buffer(self.room());
        let answer = self
            .run(transfer, Dialogue::Inquiry(inquiry, question))
            .await?;
        parse(&answer).map_err(|fault| self.error(SdoError::from_fault(transfer, fault)))
    }
}

/// A refusal of one description apart from what ends the reading.
fn refusal<T>(result: Result<T, DriveError>) -> Result<Result<T, AbortCode>, DriveError> {
    match result {
        Ok(value) => Ok(Ok(value)),
        Err(DriveError {
            error: SdoError::Aborted { code, .. },
            ..
        }) => Ok(Err(code)),
        Err(error) => Err(error),
    }
}
