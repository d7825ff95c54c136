//! Encodings for the inputs and outputs of a vehicle's station, where their types define none themselves.

/// A vector as the list of its components.
pub(crate) mod vector {
    use alloc::vec::Vec;

    use nalgebra::SVector;
    use serde::de::Error;
    use serde::{Deserialize, Deserializer, Serializer};

    pub(crate) fn serialize<S: Serializer, const N: usize>(
        vector: &SVector<f64, N>,
        serializer: S,
    ) -> Result<S::Ok, S::Error> {
        serializer.collect_seq(vector.iter())
    }

    pub(crate) fn deserialize<'de, D: Deserializer<'de>, const N: usize>(
        deserializer: D,
    ) -> Result<SVector<f64, N>, D::Error> {
        let components = Vec::<f64>::deserialize(deserializer)?;
        let wrong = |components: Vec<f64>| D::Error::invalid_length(components.len(), &"one number for each axis");
        <[f64; N]>::try_from(components).map(SVector::from).map_err(wrong)
    }
}
