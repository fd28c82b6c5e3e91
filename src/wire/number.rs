//! Numbers of proto3 JSON: plain ones or strings, with `NaN` and the infinities for floats.

use serde::Deserialize;
use serde::de::{Deserializer, Error, Unexpected, Visitor};
use std::fmt;
use std::marker::PhantomData;

/// A number read from JSON by the rules of proto3: `12`, `"12"`, `1.2e1`, and for floats `"NaN"`, `"Infinity"`,
/// `"-Infinity"`. The generated code uses it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JsonNumber<T>(pub T);

macro_rules! integer {
    ($type:ty, $expected:literal) => {
        impl FromJson for $type {
            const EXPECTED: &'static str = $expected;
            fn from_i64(v: i64) -> Option<Self> {
                Self::try_from(v).ok()
            }
            fn from_u64(v: u64) -> Option<Self> {
                Self::try_from(v).ok()
            }
            fn from_f64(v: f64) -> Option<Self> {
                // Whole numbers may be written with a fraction or an exponent; beyond 2^53 they are no longer exact.
                (v.fract() == 0.0 && v.abs() <= 9_007_199_254_740_992.0).then_some(v as i64).and_then(Self::from_i64)
            }
            fn from_text(v: &str) -> Option<Self> {
                v.parse().ok()
            }
        }
    };
}

integer!(i32, "an integer of 32 bits");
integer!(u32, "an integer of 0 to 4294967295");
integer!(i64, "an integer of 64 bits");
integer!(u64, "an integer of 0 to 18446744073709551615");

macro_rules! float {
    ($type:ty) => {
        impl FromJson for $type {
            const EXPECTED: &'static str = "a number, \"NaN\", \"Infinity\" or \"-Infinity\"";
            fn from_i64(v: i64) -> Option<Self> {
                Some(v as $type)
            }
            fn from_u64(v: u64) -> Option<Self> {
                Some(v as $type)
            }
            fn from_f64(v: f64) -> Option<Self> {
                Some(v as $type)
            }
            fn from_text(v: &str) -> Option<Self> {
                match v {
                    "NaN" => Some(<$type>::NAN),
                    "Infinity" => Some(<$type>::INFINITY),
                    "-Infinity" => Some(<$type>::NEG_INFINITY),
                    // `parse` also knows words such as `inf`, which JSON does not.
                    _ if v.bytes().all(|b| b.is_ascii_digit() || b"+-.eE".contains(&b)) => v.parse().ok(),
                    _ => None,
                }
            }
        }
    };
}

float!(f32);
float!(f64);

/// How a type of number is made of what JSON can hold; `None` is out of its range.
pub trait FromJson: Sized {
    /// What is expected, for messages.
    const EXPECTED: &'static str;
    /// From an integer.
    fn from_i64(v: i64) -> Option<Self>;
    /// From a large integer.
    fn from_u64(v: u64) -> Option<Self>;
    /// From a number with a fraction or an exponent.
    fn from_f64(v: f64) -> Option<Self>;
    /// From a string.
    fn from_text(v: &str) -> Option<Self>;
}

struct NumberVisitor<T>(PhantomData<T>);

impl<T: FromJson> Visitor<'_> for NumberVisitor<T> {
    type Value = JsonNumber<T>;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(T::EXPECTED)
    }

    fn visit_i64<E: Error>(self, v: i64) -> Result<Self::Value, E> {
        T::from_i64(v).map(JsonNumber).ok_or_else(|| E::invalid_value(Unexpected::Signed(v), &self))
    }

    fn visit_u64<E: Error>(self, v: u64) -> Result<Self::Value, E> {
        T::from_u64(v).map(JsonNumber).ok_or_else(|| E::invalid_value(Unexpected::Unsigned(v), &self))
    }

    fn visit_f64<E: Error>(self, v: f64) -> Result<Self::Value, E> {
        T::from_f64(v).map(JsonNumber).ok_or_else(|| E::invalid_value(Unexpected::Float(v), &self))
    }

    fn visit_str<E: Error>(self, v: &str) -> Result<Self::Value, E> {
        T::from_text(v).map(JsonNumber).ok_or_else(|| {
            let shown: String = v.chars().take(40).collect();
            E::invalid_value(Unexpected::Str(&shown), &self)
        })
    }
}

impl<'de, T: FromJson> Deserialize<'de> for JsonNumber<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(NumberVisitor(PhantomData))
    }
}
