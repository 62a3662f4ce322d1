// FATROP's algorithm, put together from its parts around a search direction that terminates.
#pragma once

#include "fatrop_search.hpp"

namespace trajopt {

struct FatropAlgorithm {
  std::shared_ptr<fatrop::IpData<fatrop::OcpType>> data;
  std::shared_ptr<fatrop::IpAlgorithm<fatrop::OcpType>> algorithm;
};

// Registers the options of all parts in `registry`; `look` is called before every factorisation.
FatropAlgorithm build_fatrop(const std::shared_ptr<fatrop::Nlp<fatrop::OcpType>>& nlp, fatrop::OptionRegistry& registry,
                             const std::function<void()>& look);

}  // namespace trajopt
