//! Choices of a run file and of the library: each is read, shown and stored by the same words.

use holosonar::acquisition::{Detection, PropagationModel};
use holosonar::depth::{Pick, Refine};
use holosonar::error::{Error, ErrorKind};
use holosonar::reconstruct::{Method, Window};
use holosonar::scene::{Unit, Up};
use holosonar::wave::GeometryKind;
use holosonar::wave::simd::Level;
use serde::{Deserialize, Serialize};
use std::fmt::{Debug, Display};
use std::str::FromStr;

fn words_go_there_and_back<T>(all: &[T])
where
    T: Debug + Display + Serialize + for<'de> Deserialize<'de> + FromStr<Err = Error> + PartialEq + Copy,
{
    for choice in all {
        let word = choice.to_string();
        assert_eq!(word.parse::<T>().as_ref(), Ok(choice));
        assert_eq!(serde_json::to_value(choice).expect("a word"), serde_json::json!(word));
        assert_eq!(serde_json::from_value::<T>(serde_json::json!(word)).expect("known"), *choice);
    }
    for wrong in ["", "Auto", "no such word"] {
        let error = wrong.parse::<T>().expect_err("unknown");
        assert_eq!(error.kind(), ErrorKind::InvalidInput);
        for choice in all {
            assert!(error.to_string().contains(&choice.to_string()), "{error}: {choice}");
        }
    }
}

#[test]
fn every_choice_is_read_and_shown_alike() {
    words_go_there_and_back(Method::ALL);
    words_go_there_and_back(Window::ALL);
    words_go_there_and_back(Detection::ALL);
    words_go_there_and_back(PropagationModel::ALL);
    words_go_there_and_back(GeometryKind::ALL);
    words_go_there_and_back(Pick::ALL);
    words_go_there_and_back(Refine::ALL);
    words_go_there_and_back(Unit::ALL);
    words_go_there_and_back(Up::ALL);
    words_go_there_and_back(Level::ALL);
    assert_eq!(format!("[{:>14}]", Method::Convolution), "[   convolution]", "it can be aligned");
}
